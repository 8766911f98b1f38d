"""Text out of recordings as people may see it: names there are whatever a publisher put into them."""

from __future__ import annotations

import unicodedata
from typing import Final

LONGEST_NAME: Final = 200
"""Characters of a name that are shown."""
LONGEST_SENTENCE: Final = 1000
"""Characters of a sentence that are shown on a page; it may hold a few names."""
LONGEST_FAULT: Final = 400
"""Characters of a fault that are shown in a line of a terminal."""

_UNSEEN: Final = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
"""Unicode categories that do not show themselves, but move the cursor, turn the direction of writing or cannot be
encoded: controls, formats, surrogates, private use, unassigned, separators of lines and paragraphs."""


def shown(text: str, longest: int = LONGEST_NAME) -> str:
    r"""Make text fit for a terminal, a page or a picture.

    Args:
        text: A name or a sentence out of a recording.
        longest: Characters kept of it.

    Returns:
        One line: controls and the like as escapes (``\x1b``, ``\u202e``), overlong text cut with an ellipsis.
    """
    cut = text if len(text) <= longest else f"{text[: longest - 1]}…"
    return "".join(_escaped(c) if unicodedata.category(c) in _UNSEEN else c for c in cut)


def _escaped(character: str) -> str:
    code = ord(character)
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
