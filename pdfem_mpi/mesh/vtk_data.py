"""Arrays of a VTK XML file: text, base64 or raw bytes, as they are or in blocks compressed by zlib, LZ4 or LZMA."""

from __future__ import annotations

import base64
import binascii
import lzma
import warnings
import zlib
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.mesh.raw import Refusal, excerpt

TYPES = {
    "Float32": "f4", "Float64": "f8", "Int8": "i1", "Int16": "i2", "Int32": "i4", "Int64": "i8",
    "UInt8": "u1", "UInt16": "u2", "UInt32": "u4", "UInt64": "u8",
}  # fmt: skip
COMPRESSORS = ("", "vtkZLibDataCompressor", "vtkLZ4DataCompressor", "vtkLZMADataCompressor")


@dataclass(frozen=True)
class Coding:
    """How a file's arrays are written.

    Attributes
    ----------
    order : str
        ``<`` or ``>``.
    header : str
        Type of the counts before an array: ``u4`` or ``u8``.
    compressor : str
    appended : bytes
        What follows the mark of the appended data.
    raw : bool
        The appended data are bytes, not base64.
    """

    order: str
    header: str
    compressor: str
    appended: bytes
    raw: bool


def read_array(element, coding: Coding, count: int) -> np.ndarray:
    """The values of a ``DataArray``, flat, in the machine's byte order.

    Parameters
    ----------
    element : xml.etree.ElementTree.Element
    count : int
        How many values it must have.
    """
    name, kind = element.get("Name", ""), element.get("type", "")
    if kind not in TYPES:
        raise Refusal(
            f"the array {excerpt(name)} is of type {excerpt(kind)}, which is not known. Write the mesh again."
        )
    dtype = np.dtype(coding.order + TYPES[kind])
    style = element.get("format", "ascii")
    if style == "ascii":
        values = _from_text(element.text or "", np.dtype(TYPES[kind]), name)
    else:
        text, raw = (element.text or "").encode("ascii", "replace"), False
        if style == "appended":
            offset = element.get("offset", "")
            if not offset.isdigit() or int(offset[:19]) >= len(coding.appended):
                raise Refusal(
                    f"the array {excerpt(name)} begins at {excerpt(offset)} of {len(coding.appended)} bytes appended. "
                    "The "
                    "file was cut off: write it again."
                )
            text, raw = coding.appended[int(offset) :], coding.raw
        elif style != "binary":
            raise Refusal(
                f"the array {excerpt(name)} has the format {excerpt(style)}. Write ascii, binary or appended."
            )
        data = (_compressed if coding.compressor else _plain)(_Stream(text, raw, name), coding, count * dtype.itemsize)
        if len(data) % dtype.itemsize:
            raise Refusal(_cut_off(name))
        values = np.frombuffer(data, dtype).astype(dtype.newbyteorder("="))
    if len(values) != count:
        raise Refusal(
            f"the array {excerpt(name)} has {len(values)} values, and its piece declares {count}. Write the mesh again."
        )
    return values


def _cut_off(name: str) -> str:
    return f"the array {excerpt(name)} ends before its size says. The file was cut off: write it again."


def _from_text(text: str, dtype: np.dtype, name: str) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            wide = np.fromstring(text, np.float64 if dtype.kind == "f" else np.int64, sep=" ")
            return wide.astype(dtype) if dtype.kind == "f" else wide
        except (DeprecationWarning, ValueError):
            raise Refusal(f"the array {excerpt(name)} holds what is no number. Write the mesh again.") from None
        except RuntimeWarning:
            raise Refusal(f"the array {excerpt(name)} holds numbers beyond its type. Write the mesh again.") from None


class _Stream:
    """Bytes of an array, raw or in base64, taken in parts that were encoded each by itself."""

    def __init__(self, text: bytes, raw: bool, name: str) -> None:
        self.text = text if raw else b"".join(text.split())
        self.raw, self.name, self.place = raw, name, 0

    def take(self, size: int) -> bytes:
        """The next bytes."""
        length = size if self.raw else 4 * -(-size // 3)
        part = self.text[self.place : self.place + length]
        self.place += length
        if len(part) < length:
            raise Refusal(_cut_off(self.name))
        if self.raw:
            return part
        try:
            return base64.b64decode(part, validate=True)[:size]
        except binascii.Error:
            raise Refusal(f"the array {excerpt(self.name)} is not base64. Write the mesh again.") from None


def _plain(stream: _Stream, coding: Coding, wanted: int) -> bytes:
    """Size and bytes; some write them in one piece of base64, some in two."""
    width = np.dtype(coding.header).itemsize
    size = int.from_bytes(stream.take(width), "little" if coding.order == "<" else "big")
    if size != wanted:
        raise Refusal(
            f"the array {excerpt(stream.name)} has {size} bytes, and its piece declares {wanted}. Write the mesh again."
        )
    if stream.raw or stream.text[: stream.place].endswith(b"="):
        return stream.take(size)
    stream.place = 0
    return stream.take(width + size)[width:]


def _compressed(stream: _Stream, coding: Coding, wanted: int) -> bytes:
    """Number of blocks, size of each and of the last, compressed sizes, blocks."""
    word = np.dtype(coding.order + coding.header)
    start = stream.place
    n_blocks = int(np.frombuffer(stream.take(word.itemsize), word)[0])
    if n_blocks > len(stream.text):
        raise Refusal(_cut_off(stream.name))
    stream.place = start
    _, size, last, *packed = np.frombuffer(stream.take((3 + n_blocks) * word.itemsize), word).tolist()
    sizes = [size] * n_blocks
    if n_blocks and last:
        sizes[-1] = last
    if sum(sizes) != wanted:
        raise Refusal(
            f"the array {excerpt(stream.name)} has {sum(sizes)} bytes, and its piece declares {wanted}. Write the mesh "
            "again."
        )
    data, place, parts = stream.take(sum(packed)), 0, []
    for length, own in zip(sizes, packed, strict=True):
        parts.append(_unpack(data[place : place + own], length, coding.compressor, stream.name))
        place += own
    return b"".join(parts)


def _unpack(data: bytes, size: int, compressor: str, name: str) -> bytes:
    try:
        if compressor == "vtkZLibDataCompressor":
            unpacked = zlib.decompressobj().decompress(data, size + 1)
        elif compressor == "vtkLZMADataCompressor":
            unpacked = lzma.LZMADecompressor().decompress(data, size + 1)
        else:
            unpacked = unpack_lz4(data, size)
    except (zlib.error, lzma.LZMAError, EOFError, IndexError, ValueError):
        unpacked = b""
    if len(unpacked) != size:
        raise Refusal(f"a compressed block of the array {excerpt(name)} is damaged. Write the mesh again.")
    return unpacked


def unpack_lz4(data: bytes, size: int) -> bytes:
    """Unpack one LZ4 block: literals, then a copy of what was written some way back, and again.

    Raises
    ------
    IndexError, ValueError
        Data that are no such block of this size.
    """
    out, place, end = bytearray(), 0, len(data)
    while place < end:
        token = data[place]
        literals, place = _length(data, place + 1, token >> 4)
        out += data[place : place + literals]
        place += literals
        if place >= end:
            break
        back = data[place] | data[place + 1] << 8
        copied, place = _length(data, place + 2, token & 15)
        copied += 4
        start = len(out) - back
        if not back or start < 0 or len(out) + copied > size:
            raise ValueError("a copy from before the block, or beyond its end")
        if back >= copied:
            out += out[start : start + copied]
        else:  # the copy overlaps itself: what is copied repeats
            out += (bytes(out[start:]) * (copied // back + 1))[:copied]
    return bytes(out)


def _length(data: bytes, place: int, length: int) -> tuple[int, int]:
    """A length of which 15 and each 255 mean that it goes on in the next byte; and the place after it."""
    if length == 15:
        while True:
            more = data[place]
            place += 1
            length += more
            if more != 255:
                break
    return length, place
