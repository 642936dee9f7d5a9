# SPDX-License-Identifier: GPL-3.0-or-later
"""PVM volumes (the format of the V^3 renderer), bare or in their compressed DDS envelope, read and written.

A container is a text header ("PVM", "PVM2" or "PVM3"; size; edge lengths, but not in "PVM"; bytes a voxel), the voxels,
x fastest, and in "PVM3" four texts, each ended by a NUL. 16-bit voxels are unsigned and big-endian. The envelope is
a stream of bits, most significant first: runs of up to 127 residuals of one width, against a prediction from the
neighbours along x and y; before that, the bytes of wider voxels are split into planes.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..grid import DensityGrid
from .base import GENERATOR, MAX_VOXELS, FormatError, GridInfo, Volume, replacing, select

TEXTS = ("description", "courtesy", "parameter", "comment")
"""The four texts of a PVM3 file; a grid's metadata holds them under these names."""

WHOLE, BLOCKED = b"DDS v3d\n", b"DDS v3e\n"
MAGICS = (WHOLE, BLOCKED, b"PVM\n", b"PVM2\n", b"PVM3\n", b"PVM\r\n", b"PVM2\r\n", b"PVM3\r\n")

BLOCK = 1 << 24
"""Elements whose planes are split together in "DDS v3e"; the writer takes that for containers of more bytes."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Weights of red, green and blue (ITU-R BT.709)."""

HEADER_ROOM = 1024
"""Bytes within which a header must end; V^3 itself has room for 256."""

PIECE = 1 << 15
"""Runs packed or unpacked at once, and bytes walked at once: few enough for their arrays to stay in the cache."""

_WIDTHS = np.array([0, 2, 3, 4, 5, 6, 7, 8], np.int32)  # bits of a residual, by a run's code
_MIDDLES = np.where(_WIDTHS, 1 << np.maximum(_WIDTHS - 1, 0), 0).astype(np.int32)  # is stored for the residual 0
_STEPS = np.array([10 + (h >> 3) * _WIDTHS[h & 7] if h >> 3 else 0 for h in range(1024)], np.uint16)  # bits of a run
_CODES = np.array(  # the narrowest code for a residual, by its byte
    [int(np.argmax((r >= -_MIDDLES) & (r < np.maximum(_MIDDLES, 1)))) for r in (*range(128), *range(-128, 0))], np.uint8
)
_LONGEST = 127
_UNIT = 4  # residuals that share a width in what is written
_PASSES = 2

_HEADER = re.compile(
    rb"PVM([23])?[ \t\r]*\n\s*(\d{1,10})\s+(\d{1,10})\s+(\d{1,10})[ \t\r]*\n\s*"
    rb"(?(1)([\d.eE+-]+)\s+([\d.eE+-]+)\s+([\d.eE+-]+)[ \t\r]*\n\s*)(\d{1,10})[ \t\r]*\n"
)
_WINDOW = re.compile(r"window=([\d.e+-]+):([\d.e+-]+)")


class Header(NamedTuple):
    """The head of a container: edges of a voxel are relative lengths, components are bytes a voxel."""

    version: str
    shape: tuple[int, int, int]
    edges: tuple[float, float, float]
    components: int
    length: int  # of the header itself

    @property
    def end(self) -> int:
        """The byte after the last voxel."""
        nx, ny, nz = self.shape
        return self.length + nx * ny * nz * self.components


def read(path: Path, grid: str | int | None) -> Volume:
    """The volume in a PVM file, RGB as its luminance. Raises FormatError for a damaged file or more than 3 components.

    8 bits give the window 0:255; 16 bits (often 12 of them used) none, so that the greatest value will be full, unless
    this module wrote the file and noted the window in its parameter text.
    """
    header, container, texts, spare = _load(path)
    info = _info(header, texts)
    select([info], grid, path)
    nx, ny, nz = header.shape
    voxels = container[header.length : header.end]
    if header.components == 2:
        voxels = voxels.view(">u2").astype(np.uint16)
    elif header.components == 3:
        voxels = voxels.reshape(-1, 3) @ LUMINANCE
    values = np.ascontiguousarray(voxels.reshape(nz, ny, nx).transpose(2, 1, 0))
    noted = _WINDOW.search(texts.get("parameter", ""))
    window = (0.0, 255.0) if header.components != 2 else (float(noted[1]), float(noted[2])) if noted else None
    notes = [f"{spare} bytes after the volume were ignored"] if spare else []
    assert info.transform is not None
    return Volume(path, info, values, info.transform, window, notes=notes)


def list_grids(path: Path) -> list[GridInfo]:
    """The one volume of a PVM file, named "density", with its texts as metadata. Raises FormatError."""
    header, _, texts, _ = _load(path)
    return [_info(header, texts)]


def write(grid: DensityGrid, path: Path, bits: int) -> None:
    """Write density as 8 or 16 bits in a DDS envelope, with the grid's texts; of its transform, only the edge."""
    if bits not in (8, 16):
        raise FormatError(f"{path}: a PVM file has 8 or 16 bits a voxel, not {bits}")
    full = (1 << bits) - 1
    voxels = np.rint(grid.density * np.float32(full)).astype(f"u{bits // 8}")
    texts = {name: str(grid.metadata.get(name, "")) for name in TEXTS}
    kept = [line for line in texts["parameter"].split("\n") if not re.match("window=|generator=|$", line)]
    texts["parameter"] = "\n".join([*kept, f"generator={GENERATOR}", f"window=0:{full}"])
    data = encode(pack(voxels, (grid.voxel_size,) * 3, texts), grid.shape[0], bits // 8)
    with replacing(path) as part:
        part.write_bytes(data)


def pack(voxels: np.ndarray, edges: tuple[float, float, float], texts: dict[str, str]) -> bytes:
    """A bare container of uint8 or uint16 (nx, ny, nz): "PVM3" with a text, "PVM2" with an edge not 1, else "PVM"."""
    ends = [texts.get(name, "").replace("\0", " ").encode() + b"\0" for name in TEXTS]
    texted = any(len(end) > 1 for end in ends)
    scale = "{:.9g} {:.9g} {:.9g}\n".format(*edges)
    version, scale = ("PVM3", scale) if texted else ("PVM2", scale) if scale != "1 1 1\n" else ("PVM", "")
    nx, ny, nz = voxels.shape
    head = f"{version}\n{nx} {ny} {nz}\n{scale}{voxels.itemsize}\n".encode()
    stored = voxels.transpose(2, 1, 0).astype(voxels.dtype.newbyteorder(">"), order="C")
    return head + stored.tobytes() + (b"".join(ends) if texted else b"")


def encode(container: bytes, width: int, components: int) -> bytes:
    """Put a container into a DDS envelope; ``width`` is its volume's nx, ``components`` its bytes a voxel."""
    data = np.frombuffer(container, np.uint8)
    magic, block = (BLOCKED, components * BLOCK) if data.size > BLOCK else (WHOLE, data.size)
    strip = width if width <= 1 << 16 else 1
    if components > 1:
        split = np.empty_like(data)
        for to, plane in _planes(data.size, components, block):
            split[to] = data[plane]
        data = split
    residuals = np.diff(data, prepend=np.uint8(0))
    if strip > 1:
        steps = residuals.copy()
        residuals[strip + 1 :] -= steps[1:-strip]

    # Residuals go in units of one width; equal neighbours are one run, of as many units as a run can hold.
    units = np.maximum.reduceat(_CODES[residuals], np.arange(0, data.size, _UNIT))
    for _ in range(_PASSES):
        units = _smoother(units)
    numbers = np.arange(units.size)
    changes = np.diff(units, prepend=np.uint8(255)) != 0
    since = numbers - np.maximum.accumulate(np.where(changes, numbers, 0))
    first = np.flatnonzero(since % (_LONGEST // _UNIT) == 0)
    lengths = np.diff(first * _UNIT, append=data.size).astype(np.int32)
    codes = units[first]

    ahead = [components - 1, (strip - 1) >> 8, (strip - 1) & 255], [2, 8, 8]
    ends = np.cumsum(_STEPS[(lengths << 3) + codes], dtype=np.int64) + sum(ahead[1])
    stream = np.zeros(int(ends[-1] + 7) // 8 + 1, np.uint8)
    _put(stream, 0, np.array(ahead[0], np.int32), np.array(ahead[1], np.int32))
    start, place = 0, sum(ahead[1])
    for at in range(0, lengths.size, PIECE):
        n, code = lengths[at : at + PIECE], codes[at : at + PIECE].astype(np.int32)
        run = np.repeat(np.arange(n.size, dtype=np.int32), n)
        heads = np.cumsum(n) - n + 2 * np.arange(n.size)  # each run is its length, its code, its values
        symbols = np.empty(run.size + 2 * n.size, np.int32)
        widths = np.empty_like(symbols)
        symbols[heads], widths[heads] = n, 7
        symbols[heads + 1], widths[heads + 1] = code, 3
        values = np.arange(run.size) + 2 * (run + 1)
        signed = residuals[start : start + run.size].view(np.int8)
        symbols[values], widths[values] = signed + _MIDDLES[code][run], _WIDTHS[code][run]
        _put(stream, place, symbols, widths)
        start, place = start + run.size, int(ends[at + n.size - 1])
    return magic + stream[: (place + 7) // 8].tobytes()


def _smoother(units: np.ndarray) -> np.ndarray:
    """Widen short runs to a neighbour's width where that takes fewer bits than the head of a run of their own."""
    starts = np.flatnonzero(np.diff(units, prepend=np.uint8(255)))
    counts = np.diff(starts, append=units.size)
    codes = units[starts]
    around = np.pad(codes, 1)
    before, after = around[:-2], around[2:]
    wider = np.where(np.minimum(before, after) > codes, np.minimum(before, after), np.maximum(before, after))
    costs = counts * _UNIT * (_WIDTHS[wider] - _WIDTHS[codes])
    return np.repeat(np.where((wider > codes) & (costs < 10), wider, codes), counts)


def _put(stream: np.ndarray, place: int, symbols: np.ndarray, widths: np.ndarray) -> None:
    """Add symbols of up to 8 bits to a stream of bytes, from the bit ``place`` on."""
    bits = np.cumsum(widths) - widths + (place & 7)
    pairs = symbols << (16 - widths - (bits & 7))
    into = stream[place >> 3 : (place >> 3) + (int(bits[-1]) >> 3) + 2]
    for byte, half in ((bits >> 3, pairs >> 8), ((bits >> 3) + 1, pairs & 255)):
        into += np.bincount(byte, half, into.size)[: into.size].astype(np.uint8)  # no two symbols share a bit


class _Envelope(NamedTuple):
    """A DDS stream of which the runs are known, but not yet unpacked."""

    stream: np.ndarray  # uint8, ended by some zeros
    starts: np.ndarray  # int64, the bit at which each run begins
    lengths: np.ndarray
    codes: np.ndarray
    strip: int
    planes: int
    block: int
    spare: int  # bytes after the end of the stream

    @property
    def size(self) -> int:
        """Bytes of the container inside."""
        return int(self.lengths.sum())

    def unpack(self, at_least: int | None = None) -> np.ndarray:
        """The container's bytes, or only its first ones where there is but one plane."""
        runs = self.starts.size
        if at_least is not None:
            runs = min(runs, int(np.searchsorted(np.cumsum(self.lengths), at_least)) + 1)
        data = np.empty(int(self.lengths[:runs].sum()), np.uint8)
        pairs = (self.stream[:-1].astype(np.uint16) << 8) | self.stream[1:]
        done = 0
        for at in range(0, runs, PIECE):
            piece = slice(at, min(at + PIECE, runs))
            n, base = self.lengths[piece], int(self.starts[at]) & ~7
            width, middle = _WIDTHS[self.codes[piece]], _MIDDLES[self.codes[piece]]
            begins = np.cumsum(n) - n
            values = (self.starts[piece] - base).astype(np.int32) + 10 - begins * width
            each = np.repeat(width, n)
            bits = np.arange(each.size, dtype=np.int32) * each + np.repeat(values, n)
            windows = pairs[base >> 3 :][bits >> 3].astype(np.int32) << (bits & 7)
            data[done : done + each.size] = ((windows & 0xFFFF) >> (16 - each)) - np.repeat(middle, n)
            done += each.size
        if self.strip > 1:  # bytes past the first are steps, and those past the first row are against the row before
            steps, strip = data[1:], self.strip
            rows = steps.size // strip
            whole = steps[: rows * strip].reshape(rows, strip)
            np.cumsum(whole, axis=0, dtype=np.uint8, out=whole)
            if rows:
                steps[rows * strip :] += whole[-1, : steps.size - rows * strip]
        np.cumsum(data, dtype=np.uint8, out=data)
        if self.planes == 1:
            return data
        joined = np.empty_like(data)
        for to, plane in _planes(data.size, self.planes, self.block):
            joined[plane] = data[to]
        return joined


def _planes(size: int, planes: int, block: int) -> Iterator[tuple[slice, slice]]:
    """Where each plane of each block lies: in the stream (together), and in the container (every so many bytes)."""
    for begin in range(0, size, block):
        end = min(begin + block, size)
        at = begin
        for plane in range(planes):
            count = len(range(begin + plane, end, planes))
            yield slice(at, at + count), slice(begin + plane, end, planes)
            at += count


def _envelope(path: Path, data: bytes) -> _Envelope:
    """Find the runs of a DDS stream. Raises FormatError for one that is cut, or that would unpack to too much."""
    stream = np.frombuffer(data + bytes(4), np.uint8)[len(WHOLE) :]
    size = stream.size - 4
    ahead = int.from_bytes(stream[:3].tobytes(), "big") >> 6
    planes, strip = (ahead >> 16) + 1, (ahead & 0xFFFF) + 1
    starts, place, ended = array("q"), 18, False
    for base in range(0, size, PIECE):  # a run's head tells where the next one is: look up the step from every bit
        near = stream[base : base + PIECE + 2].astype(np.uint32)
        three = (near[:-2] << 16) | (near[1:-1] << 8) | near[2:]
        count = min(PIECE, size - base)
        steps = np.stack([_STEPS[(three[:count] >> shift) & 1023] for shift in range(14, 6, -1)], axis=1)
        table, bit = memoryview(steps.reshape(-1)), place - 8 * base
        while bit < len(table):
            step = table[bit]
            if not step:
                ended = True
                break
            starts.append(8 * base + bit)
            bit += step
        place = 8 * base + bit
        if ended:
            break
    if place > 8 * size:
        raise FormatError(f"{path}: damaged: the file is cut, its last run of voxels goes past its end")
    found = np.frombuffer(starts, np.int64)
    byte = found >> 3
    heads = (stream[byte].astype(np.int32) << 16) | (stream[byte + 1].astype(np.int32) << 8) | stream[byte + 2]
    heads = (heads >> (14 - (found & 7)).astype(np.int32)) & 1023
    block = BLOCK * planes if data.startswith(BLOCKED) else 1 << 62
    spare = size - min(size, (place + 10 + 31) // 32 * 4)  # V^3 fills up its last word
    envelope = _Envelope(stream, found, heads >> 3, heads & 7, strip, planes, block, spare)
    if envelope.size > 3 * MAX_VOXELS:
        raise FormatError(f"{path}: would unpack to {envelope.size} bytes, more than {MAX_VOXELS} voxels")
    return envelope


def _load(path: Path) -> tuple[Header, np.ndarray, dict[str, str], int]:
    """Header, container (uint8), texts and bytes to spare; all that can be checked is checked before it is unpacked."""
    if path.stat().st_size > 4 * MAX_VOXELS:
        raise FormatError(f"{path}: is larger than any volume of {MAX_VOXELS} voxels")
    data = path.read_bytes()
    spare = 0
    if data.startswith((WHOLE, BLOCKED)):
        envelope = _envelope(path, data)
        spare = envelope.spare
        if envelope.planes == 1:
            _header(path, envelope.unpack(HEADER_ROOM)[:HEADER_ROOM].tobytes(), envelope.size)
        container = envelope.unpack()
    else:
        container = np.frombuffer(data, np.uint8)
    header = _header(path, container[:HEADER_ROOM].tobytes(), container.size)
    rest = container[header.end :].tobytes()
    texts: dict[str, str] = {}
    if header.version == "PVM3":
        *ends, rest = rest.split(b"\0", len(TEXTS))
        if len(ends) < len(TEXTS):
            raise FormatError(f"{path}: damaged: only {len(ends)} of the {len(TEXTS)} texts at its end are whole")
        texts = {name: _text(end) for name, end in zip(TEXTS, ends, strict=True) if end}
    return header, container, texts, spare + len(rest)


def _header(path: Path, head: bytes, size: int) -> Header:
    """Read the head of a container of ``size`` bytes. Raises FormatError when it cannot be true."""
    match = _HEADER.match(head)
    if not match:
        raise FormatError(f"{path}: damaged: no PVM header where one must be")
    version, nx, ny, nz, *scale, components = match.groups()
    try:
        x, y, z = (float(edge) for edge in (scale if version else (1, 1, 1)))
    except ValueError:
        x = y = z = 0.0
    header = Header(
        f"PVM{(version or b'').decode()}", (int(nx), int(ny), int(nz)), (x, y, z), int(components), match.end()
    )
    if not all(0.0 < edge < np.inf for edge in header.edges):
        raise FormatError(f"{path}: damaged: its header gives voxel edges that are no lengths")
    if header.components > 3:
        raise FormatError(f"{path}: has {header.components} bytes a voxel, and only 1, 2 or 3 have an agreed meaning")
    voxels = " x ".join(map(str, header.shape))
    if header.end == header.length:
        raise FormatError(f"{path}: damaged: its header promises {voxels} voxels of {header.components} bytes: nothing")
    if header.end > size:
        raise FormatError(
            f"{path}: damaged: its header promises {voxels} voxels of {header.components} bytes, "
            f"{header.end - header.length} in all, but it holds {size - header.length}"
        )
    if np.prod(header.shape, dtype=float) > MAX_VOXELS:
        raise FormatError(f"{path}: has {voxels} voxels, more than the {MAX_VOXELS} that are read")
    return header


def _info(header: Header, texts: dict[str, str]) -> GridInfo:
    kind = {1: "uint8", 2: "uint16", 3: "rgb8"}[header.components]
    transform = np.diag([*header.edges, 1.0])
    return GridInfo("density", 0, "density", header.version, kind, header.shape, transform, metadata=dict(texts))


def _text(data: bytes) -> str:
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")
