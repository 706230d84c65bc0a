"""How much two pictures show the same: the share of their features that match (B eq. 5)."""

from __future__ import annotations

from app.vision.matching import Unit, match_unit_vectors


def content_similarity(a: Unit, b: Unit, ratio: float, binary: bool = False) -> float:
    """Return S = 2 N(a, b) / (N_a + N_b), 0 to 1, of the unit descriptors (n, d), (m, d) of two pictures.

    N(a, b) counts the mutual nearest neighbours that pass the ratio test among b's (B eq. 3-4); S is 0 where there
    is nothing to match. Source: B eq. 5.
    """
    total = len(a) + len(b)
    if total == 0:
        return 0.0
    rows, _, _ = match_unit_vectors(a, b, ratio, binary)
    return 2.0 * len(rows) / total
