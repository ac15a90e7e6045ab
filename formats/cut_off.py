"""What tells that a text without a closing line of its own was cut off: its last line has no end."""

from __future__ import annotations


def unended(text: str | bytes) -> tuple[str, ...]:
    """A warning for a text whose last line has no end, none for others. A number cut in two reads as another number."""
    last = text[-1:] if isinstance(text, bytes) else text[-1:].encode("utf-8", "replace")
    return () if last in (b"\n", b"\r", b"") else ("its last line has no end: the file may have been cut off",)
