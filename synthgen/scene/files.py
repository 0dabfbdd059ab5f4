"""The user's pictures and panoramas: found, checked before they are used, and read bounded.

They may be wrong or hostile: sizes are read from headers before anything is decoded.
"""

from __future__ import annotations

import hashlib
import struct
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from synthgen.errors import FileError
from synthgen.scene.description import Picture

Kind = Literal["image", "panorama"]
Image = NDArray[np.float32]

MAX_BYTES, MAX_SIDE, MIN_SIDE, MAX_FILES = 512 * 2**20, 16384, 16, 20_000
# Of an OpenEXR file, all channels: the largest panorama of four.
MAX_DECODED = 2**31
SUFFIXES: dict[str, tuple[str, ...]] = {
    "image": (".jpg", ".jpeg", ".png"),
    "panorama": (".exr",),
}
# What is kept of a file; a light map needs few pixels, a wall no more than the picture shows.
PANORAMA_PX, IMAGE_PX = (512, 256), 1024


def candidates(place: str, kind: Kind) -> tuple[Path, ...]:
    """Return the files that a setting means, sorted: one file, or those of a folder.

    Raises
    ------
    FileError
        If there is nothing of the kind, or far too much.
    """
    path = Path(place).expanduser().resolve()
    wanted = ", ".join(SUFFIXES[kind])
    if path.is_file():
        return (path,)
    if not path.is_dir():
        raise FileError(f"{place} is neither a file nor a folder; give a {wanted} file or a folder")
    found = _listed(path, kind, path.stat().st_mtime_ns)
    if not found:
        raise FileError(f"{place} holds no {wanted} file; add some, or name another folder")
    if len(found) > MAX_FILES:
        raise FileError(f"{place} holds {len(found)} files; at most {MAX_FILES}, split the folder")
    return found


@lru_cache(maxsize=16)
def _listed(folder: Path, kind: Kind, stamp: int) -> tuple[Path, ...]:
    """List a folder as it was at a time stamp; what only looks like a file is passed over."""
    named = (p for p in folder.iterdir() if p.suffix.lower() in SUFFIXES[kind])
    return tuple(sorted(p for p in named if p.is_file()))


def listing_digest(place: str, kind: Kind) -> str:
    """Return a SHA-256 of names and sizes of the candidates, among which samples choose."""
    told = [(path.name, path.stat().st_size) for path in candidates(place, kind)]
    return hashlib.sha256(repr(told).encode()).hexdigest()


def checked(path: Path, kind: Kind, licence: str) -> Picture:
    """Check a file's header and describe it.

    Raises
    ------
    FileError
        Naming the file, what is wrong, and what is allowed.
    """
    try:
        state = path.stat()
        if not path.is_file():
            raise FileError(f"{path} is a folder, pipe or device; a picture is a file")
        if state.st_size > MAX_BYTES:
            raise FileError(f"{path} has {state.st_size} bytes; at most {MAX_BYTES}, scale it down")
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}") from None
    return _described(path, kind, licence, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=4096)
def _described(path: Path, kind: Kind, licence: str, stamp: int, size: int) -> Picture:
    """Check a file as it was at a time stamp."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}") from None
    width, height = _exr_size(path) if kind == "panorama" else _image_size(path, data)
    if not (MIN_SIDE <= width <= MAX_SIDE and MIN_SIDE <= height <= MAX_SIDE):
        raise FileError(
            f"{path} is {width} x {height} pixels; each side must be {MIN_SIDE} to {MAX_SIDE}"
        )
    if kind == "panorama" and width != 2 * height:
        raise FileError(
            f"{path} is {width} x {height} pixels; a latitude-longitude panorama is twice as wide "
            "as it is high"
        )
    return Picture(str(path), hashlib.sha256(data).hexdigest(), licence)


def _image_size(path: Path, data: bytes) -> tuple[int, int]:
    """Read width and height from a PNG's or JPEG's header."""
    if data[:8] == b"\x89PNG\r\n\x1a\n" and len(data) >= 24:
        width, height = struct.unpack(">II", data[16:24])
        return int(width), int(height)
    if data[:2] == b"\xff\xd8":
        place = 2
        while place + 9 < len(data) and data[place] == 0xFF:
            if data[place + 1] == 0xFF:  # any number of these may stand before a marker
                place += 1
                continue
            marker, length = data[place + 1], struct.unpack(">H", data[place + 2 : place + 4])[0]
            if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
                height, width = struct.unpack(">HH", data[place + 5 : place + 9])
                return int(width), int(height)
            place += 2 + length
    raise FileError(f"{path} is no PNG or JPEG picture, or its header is damaged")


def _exr_size(path: Path) -> tuple[int, int]:
    import OpenEXR

    try:
        with OpenEXR.File(str(path), header_only=True) as file:
            header, parts = file.header(), len(file.parts)
            (left, top), (right, bottom) = np.array(header["dataWindow"], np.int64).tolist()
            names = {channel.name for channel in header["channels"]}
    except Exception as error:  # OpenEXR raises its own and RuntimeError alike
        raise FileError(f"{path} is no readable OpenEXR file: {error}") from None
    if not {"R", "G", "B"} <= names:
        raise FileError(
            f"{path} has the channels {', '.join(sorted(names)) or 'none'}; "
            "a panorama needs R, G, B"
        )
    width, height = right - left + 1, bottom - top + 1
    if parts != 1 or 4 * width * height * len(names) > MAX_DECODED:
        raise FileError(
            f"{path} holds {parts} part(s), {len(names)} channels of {width} x {height} pixels; a "
            f"panorama is one part of at most {MAX_DECODED} bytes, decoded: save R, G, B alone"
        )
    return width, height


def read_image(picture: Picture) -> Image:
    """Return a picture as linear sRGB (h, w, 3) float32, at most 1024 pixels a side."""
    data = _bytes(picture)
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if pixels is None:
        raise FileError(f"{picture.path} cannot be decoded; repair or remove it")
    scale = IMAGE_PX / max(pixels.shape[:2])
    if scale < 1:
        size = (max(1, round(pixels.shape[1] * scale)), max(1, round(pixels.shape[0] * scale)))
        pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
    x = np.asarray(pixels[..., ::-1], dtype=np.float32) / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)


def read_panorama(picture: Picture) -> Image:
    """Return a panorama's radiance (256, 512, 3) float32, its sun kept as energy.

    Raises
    ------
    FileError
        If it is damaged, changed since the plan, or holds no finite light.
    """
    import OpenEXR

    _bytes(picture)
    try:
        with OpenEXR.File(picture.path, separate_channels=True) as file:
            planes = [np.asarray(file.channels()[c].pixels, np.float32) for c in "RGB"]
    except Exception as error:
        raise FileError(f"{picture.path} cannot be decoded: {error}") from None
    if len({plane.shape for plane in planes}) > 1:
        shapes = ", ".join(f"{c} {plane.shape}" for c, plane in zip("RGB", planes, strict=True))
        raise FileError(
            f"{picture.path} keeps its channels in different sizes ({shapes}); save it without "
            "subsampling"
        )
    pixels: Any = np.stack(planes, axis=-1)
    if not np.isfinite(pixels).all() or pixels.min() < 0 or pixels.max() <= 0:
        raise FileError(f"{picture.path} holds negative or no finite light; repair it")
    return np.asarray(cv2.resize(pixels, PANORAMA_PX, interpolation=cv2.INTER_AREA), np.float32)


def _bytes(picture: Picture) -> bytes:
    try:
        data = Path(picture.path).read_bytes()
    except OSError as error:
        raise FileError(f"{picture.path}: {error.strerror}; the plan was made with it") from None
    if hashlib.sha256(data).hexdigest() != picture.sha256:
        raise FileError(f"{picture.path} changed since the plan was made; restore it or plan anew")
    return data
