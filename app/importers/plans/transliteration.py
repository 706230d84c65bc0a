"""Letters with marks written with plain ones, so that ids made from names stay readable."""

from __future__ import annotations

import unicodedata

# What a decomposition of Unicode would lose, or write other than the languages themselves do.
LETTERS = {
    "ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "æ": "ae", "œ": "oe", "ø": "oe", "å": "aa", "ł": "l", "đ": "d",
    "ð": "d", "þ": "th", "ı": "i",
}  # fmt: skip
TABLE = str.maketrans(
    LETTERS | {key.upper(): value.capitalize() for key, value in LETTERS.items() if key != "ß"}
)


def transliterated(text: str) -> str:
    """Return a text with umlauts as two letters and other letters without their marks: Büro as Buero, café as cafe.

    Letters of other scripts stay as they are.
    """
    plain = unicodedata.normalize("NFC", text).translate(TABLE)
    return "".join(c for c in unicodedata.normalize("NFKD", plain) if not unicodedata.combining(c))
