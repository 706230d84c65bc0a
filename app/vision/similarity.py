"""The content similarity of two pictures: the share of their features that match (B eq. 5)."""

from __future__ import annotations

from app.vision.matching import Unit, match_unit_vectors


def content_similarity(a: Unit, b: Unit, ratio: float, binary: bool = False) -> float:
    """Return S = 2 N(a, b) / (N_a + N_b), 0 to 1, of the unit descriptors (n, d), (m, d) of two pictures.

    N(a, b) is the number of mutual nearest neighbours that pass the ratio test in b (B eq. 3-4); S is 0 for pictures
    without features. Source: B eq. 5.
    """
    total = len(a) + len(b)
    if total == 0:
        return 0.0
    rows, _, _ = match_unit_vectors(a, b, ratio, binary)
    return 2.0 * len(rows) / total
