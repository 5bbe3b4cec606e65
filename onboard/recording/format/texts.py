"""Texts in rows: bytes that a device, or whoever made the file, chose."""


def printable(data: bytes) -> str:
    """Text for people: what is not UTF-8, and what a terminal would obey, is written as an escape."""
    text = bytes(data).decode(errors="backslashreplace")
    return text if text.isprintable() else "".join(mark if mark.isprintable() else repr(mark)[1:-1] for mark in text)
