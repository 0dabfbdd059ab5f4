"""The user's pictures and panoramas: what is wrong with them is said before they are used."""

from __future__ import annotations

import os
import struct
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import OpenEXR
import pytest

from synthgen.errors import FileError
from synthgen.scene.files import candidates, checked, listing_digest, read_image, read_panorama


def write_exr(path: Path, **planes: np.ndarray) -> Path:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, planes).write(str(path))
    return path


def panorama(path: Path, value: float = 0.5, shape: tuple[int, int] = (32, 64)) -> Path:
    return write_exr(path, **{c: np.full(shape, value, np.float32) for c in "RGB"})


def test_smoke_picture(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.full((40, 60, 3), (10, 128, 255), np.uint8))
    picture = checked(path, "image", "CC0")
    assert picture.licence == "CC0"
    pixels = read_image(picture)
    assert pixels.shape == (40, 60, 3)
    np.testing.assert_allclose(pixels[0, 0], [1.0, 0.2158605, 0.003035], atol=1e-5)


def test_smoke_panorama(tmp_path: Path) -> None:
    picture = checked(panorama(tmp_path / "a.exr"), "panorama", "own work")
    np.testing.assert_allclose(read_panorama(picture), 0.5, atol=1e-5)


def test_smoke_jpeg_size_is_read_from_its_header(tmp_path: Path) -> None:
    path = tmp_path / "a.jpg"
    cv2.imwrite(str(path), np.zeros((33, 47, 3), np.uint8))
    assert read_image(checked(path, "image", "CC0")).shape == (33, 47, 3)
    filled = path.read_bytes().replace(b"\xff\xd8\xff", b"\xff\xd8" + b"\xff" * 5, 1)
    (tmp_path / "b.jpg").write_bytes(filled)
    assert read_image(checked(tmp_path / "b.jpg", "image", "CC0")).shape == (33, 47, 3)


def test_edge_folders(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"holds no \.jpg, \.jpeg, \.png file"):
        candidates(str(tmp_path), "image")
    with pytest.raises(FileError, match="neither a file nor a folder"):
        candidates(str(tmp_path / "none"), "image")
    (tmp_path / "b.png").write_bytes(b"x")
    (tmp_path / "a.PNG").write_bytes(b"x")
    assert [p.name for p in candidates(str(tmp_path), "image")] == ["a.PNG", "b.png"]


def test_edge_bomb_is_refused_from_its_header(tmp_path: Path) -> None:
    path = tmp_path / "huge.png"
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR" + struct.pack(">II", 200_000, 200_000) + bytes(9)
    )
    with pytest.raises(FileError, match="200000 x 200000"):
        checked(path, "image", "CC0")


def test_edge_what_only_looks_like_a_file(tmp_path: Path) -> None:
    """A pipe would be read for ever, a device until memory ends."""
    os.mkfifo(tmp_path / "a.png")
    (tmp_path / "b.png").symlink_to("/dev/zero")
    (tmp_path / "c.png").mkdir()
    (tmp_path / "d.png").symlink_to(tmp_path / "nowhere.png")
    for name in "abc":
        with pytest.raises(FileError, match="folder, pipe or device"):
            checked(tmp_path / f"{name}.png", "image", "CC0")
    with pytest.raises(FileError, match="No such file"):
        checked(tmp_path / "d.png", "image", "CC0")
    with pytest.raises(FileError, match="holds no"):
        candidates(str(tmp_path), "image")


def test_edge_panoramas_that_are_small_until_decoded(tmp_path: Path) -> None:
    flat = np.zeros((1024, 2048), np.float32)
    many = {c: flat for c in "RGB"} | {f"X{k:03d}": flat for k in range(300)}
    path = write_exr(tmp_path / "many.exr", **many)
    assert path.stat().st_size < 4 * 2**20
    with pytest.raises(FileError, match="303 channels of 2048 x 1024"):
        checked(path, "panorama", "CC0")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header["displayWindow"] = (np.array([0, 0], np.int32), np.array([63, 31], np.int32))
    parts = [
        OpenEXR.Part(header | {"name": name}, {c: flat[:h, :64] + 1 for c in "RGB"})
        for name, h in (("a", 32), ("b", 1024))
    ]
    OpenEXR.File(parts).write(str(tmp_path / "parts.exr"))
    with pytest.raises(FileError, match=r"2 part\(s\)"):
        checked(tmp_path / "parts.exr", "panorama", "CC0")


def test_properties_a_file_that_changed_is_described_anew(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.zeros((40, 40, 3), np.uint8))
    first, listed = checked(path, "image", "CC0"), listing_digest(str(tmp_path), "image")
    cv2.imwrite(str(path), np.full((50, 50, 3), 9, np.uint8))
    cv2.imwrite(str(tmp_path / "b.png"), np.full((50, 50, 3), 9, np.uint8))
    again = checked(path, "image", "CC0")
    assert again.sha256 != first.sha256
    assert read_image(again).shape == (50, 50, 3)
    assert len(candidates(str(tmp_path), "image")) == 2
    assert listing_digest(str(tmp_path), "image") != listed


def test_edge_no_pictures(tmp_path: Path) -> None:
    text, broken = tmp_path / "a.png", tmp_path / "b.png"
    text.write_text("not a picture")
    with pytest.raises(FileError, match="no PNG or JPEG"):
        checked(text, "image", "CC0")
    cv2.imwrite(str(broken), np.zeros((40, 40, 3), np.uint8))
    broken.write_bytes(broken.read_bytes()[:60])
    with pytest.raises(FileError, match="cannot be decoded"):
        read_image(checked(broken, "image", "CC0"))


def test_edge_odd_panoramas(tmp_path: Path) -> None:
    flat = np.ones((32, 64), np.float32)
    with pytest.raises(FileError, match="channels Y; a panorama needs R, G, B"):
        checked(write_exr(tmp_path / "y.exr", Y=flat), "panorama", "CC0")
    with pytest.raises(FileError, match="twice as wide"):
        checked(panorama(tmp_path / "square.exr", shape=(64, 64)), "panorama", "CC0")
    (tmp_path / "text.exr").write_text("no EXR")
    with pytest.raises(FileError, match="no readable OpenEXR"):
        checked(tmp_path / "text.exr", "panorama", "CC0")
    for name, value in (("nan", np.nan), ("negative", -1.0), ("dark", 0.0)):
        with pytest.raises(FileError, match="negative or no finite light"):
            read_panorama(checked(panorama(tmp_path / f"{name}.exr", value), "panorama", "CC0"))


def test_edge_changed_since_the_plan(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.zeros((40, 40, 3), np.uint8))
    picture = checked(path, "image", "CC0")
    cv2.imwrite(str(path), np.full((40, 40, 3), 9, np.uint8))
    with pytest.raises(FileError, match="changed since the plan"):
        read_image(picture)
    path.unlink()
    with pytest.raises(FileError, match="No such file"):
        read_image(picture)


def test_edge_subsampled_channels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenEXR's module reads subsampled channels, but writes none: its answer is stood in for."""
    picture = checked(panorama(tmp_path / "a.exr"), "panorama", "CC0")
    shapes = {"R": (16, 32), "G": (32, 64), "B": (16, 32)}
    planes = {c: SimpleNamespace(pixels=np.ones(s, np.float32)) for c, s in shapes.items()}
    opened = SimpleNamespace(channels=lambda: planes)
    monkeypatch.setattr(OpenEXR, "File", lambda *_, **__: nullcontext(opened))
    with pytest.raises(FileError, match=r"different sizes \(R \(16, 32\), G \(32, 64\)"):
        read_panorama(picture)
