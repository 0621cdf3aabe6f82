"""Decompression of one LZ4 block, as VTK and ParaView write it, without a library."""

from __future__ import annotations

# A length of LONG in a token continues in the next bytes; the first byte below MORE ends it.
LONG = 15
MORE = 255
# Length of the shortest copy [bytes].
SHORTEST = 4


def decompress(block: bytes) -> bytes:
    """Return the bytes of a block: literals, each followed by a copy of earlier bytes.

    Raises:
        ValueError: The block is damaged.
    """
    out = bytearray()
    at = 0
    try:
        while at < len(block):
            token = block[at]
            count, at = _length(block, at + 1, token >> 4)
            if at + count > len(block):
                raise ValueError("an array compressed by LZ4 is cut short")
            out += block[at : at + count]
            at += count
            if at == len(block):
                break
            back = block[at] | block[at + 1] << 8
            count, at = _length(block, at + 2, token & LONG)
            if not 0 < back <= len(out):
                raise ValueError("an array compressed by LZ4 is damaged")
            count += SHORTEST
            earlier = bytes(out[-back:])
            # A copy may be longer than what it repeats.
            out += (earlier * (count // back + 1))[:count]
    except IndexError:
        raise ValueError("an array compressed by LZ4 is cut short") from None
    return bytes(out)


def _length(block: bytes, at: int, start: int) -> tuple[int, int]:
    """Return a length that begins in a token, and the position after its bytes."""
    if start < LONG:
        return start, at
    while block[at] == MORE:
        start += MORE
        at += 1
    return start + block[at], at + 1
