"""Scans as files: PLY with everything per vertex, textured GLB, and OBJ with its picture."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from numpy.typing import NDArray
from PIL import Image

from synthgen.errors import IntegrityError, ScanError
from synthgen.scanner.result import Scan

_PLY_NAMES = {"f4": "float", "u1": "uchar", "i2": "short", "i4": "int"}
_FACE = np.dtype([("n", "u1"), ("v", "<i4", (3,))])
FORMATS = (".ply", ".glb", ".obj")


def save_scan(scan: Scan, path: str | Path) -> list[Path]:
    """Write a scan as PLY, GLB or OBJ, by the name's ending.

    Returns
    -------
    list of Path
        What was written: one file, or for OBJ also ``.mtl`` and ``.png`` beside it.

    Raises
    ------
    ScanError
        If the ending is another one, there is no such folder, or the scan is empty.
    """
    target = Path(path)
    if target.suffix not in FORMATS:
        raise ScanError(f"cannot write {target.name}; endings are {', '.join(FORMATS)}")
    if not target.parent.is_dir():
        raise ScanError(
            f"{target.name} is not written: there is no folder {target.parent}; make it"
        )
    if not len(scan.faces):
        raise ScanError(f"{target.name} is not written: {scan.problem or 'the scan has no face'}")
    if target.suffix == ".obj":
        return _write_obj(scan, target)
    target.write_bytes(ply_bytes(scan) if target.suffix == ".ply" else glb_bytes(scan))
    return [target]


def ply_bytes(scan: Scan) -> bytes:
    """Binary little-endian PLY: positions, normals, colours, provenance.

    ``quality`` is the confidence, which MeshLab colours by. The texture coordinates are not called
    ``s t``: readers would drop the colours for them. Readers skip what they do not know.
    """
    names = [("x", "f4"), ("y", "f4"), ("z", "f4"), ("nx", "f4"), ("ny", "f4"), ("nz", "f4"),
             ("red", "u1"), ("green", "u1"), ("blue", "u1"),
             ("atlas_u", "f4"), ("atlas_v", "f4")]  # fmt: skip
    columns: list[NDArray[Any]] = [*scan.vertices.T, *scan.normals.T, *scan.colors.T, *scan.uv.T]
    for name, values in scan.provenance.items():
        kind = values.dtype.str[1:]
        if values.ndim == 2:
            names += [(f"{name}_{k}", kind) for k in range(values.shape[1])]
            columns += list(values.T)
        else:
            names.append(("quality" if name == "confidence" else name, kind))
            columns.append(values)
    table = np.empty(len(scan.vertices), dtype=[(name, "<" + kind) for name, kind in names])
    for (name, _), values in zip(names, columns, strict=True):
        table[name] = values
    rows = np.empty(len(scan.faces), dtype=_FACE)
    rows["n"], rows["v"] = 3, scan.faces
    header = [
        "ply", "format binary_little_endian 1.0", "comment metres, rig frame, y up",
        f"element vertex {len(table)}",
        *(f"property {_PLY_NAMES[kind]} {name}" for name, kind in names),
        f"element face {len(rows)}", "property list uchar int vertex_indices", "end_header", "",
    ]  # fmt: skip
    return "\n".join(header).encode() + table.tobytes() + rows.tobytes()


def read_ply(data: bytes, what: str) -> tuple[dict[str, NDArray[Any]], NDArray[np.int32]]:
    """Read what :func:`ply_bytes` wrote: vertex properties by name, and faces (F, 3).

    Raises
    ------
    IntegrityError
        Naming ``what``, if it is no such file.
    """
    try:
        head, _, body = data.partition(b"end_header\n")
        lines = head.decode("ascii").splitlines()
        count, faces = (int(line.split()[2]) for line in lines if line.startswith("element"))
        kinds = {word: "<" + code for code, word in _PLY_NAMES.items()}
        named = [line.split()[1:] for line in lines if line.startswith("property")]
        dtype = np.dtype([(name, kinds[word]) for word, name in named[:-1]])
        table = np.frombuffer(body, dtype, count)
        rows = np.frombuffer(body, _FACE, faces, offset=table.nbytes)
    except (ValueError, KeyError, UnicodeDecodeError) as error:
        raise IntegrityError(f"{what} is damaged: no scan can be read from it ({error})") from None
    columns = {name: np.ascontiguousarray(table[name]) for name in dtype.names or ()}
    return columns, np.ascontiguousarray(rows["v"])


def glb_bytes(scan: Scan) -> bytes:
    """Binary glTF with the texture inside; vertices are repeated along the texture's seams."""
    vertices, faces, uv = _split(scan)
    visual: Any = trimesh.visual
    material = visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(scan.texture), metallicFactor=0.0, roughnessFactor=0.9
    )
    mesh = trimesh.Trimesh(
        scan.vertices[vertices], faces, vertex_normals=scan.normals[vertices], process=False,
        visual=visual.TextureVisuals(uv=uv, material=material),
    )  # fmt: skip
    exchange: Any = trimesh.exchange
    return bytes(exchange.gltf.export_glb(trimesh.Scene(mesh), include_normals=True))


def _split(scan: Scan) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
    """Vertices that have one texture coordinate each: vertex rows, faces among them, uv."""
    corner = np.ascontiguousarray(scan.corner_uv.reshape(-1, 2)).view(np.int64).ravel()
    keys = np.stack([scan.faces.ravel().astype(np.int64), corner], axis=1)
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    rows = scan.faces.ravel()[first].astype(np.int64)
    return rows, inverse.reshape(-1, 3), scan.corner_uv.reshape(-1, 2)[first]


def _write_obj(scan: Scan, target: Path) -> list[Path]:
    rows, faces, uv = _split(scan)
    picture, material = target.with_suffix(".png"), target.with_suffix(".mtl")
    text = io.StringIO()
    text.write(f"# metres, rig frame, y up\nmtllib {material.name}\nusemtl scan\n")
    np.savetxt(text, scan.vertices, "v %.7f %.7f %.7f")
    np.savetxt(text, scan.normals, "vn %.5f %.5f %.5f")
    np.savetxt(text, uv, "vt %.6f %.6f")
    corner = np.stack([rows[faces] + 1, faces + 1, rows[faces] + 1], axis=-1)
    np.savetxt(text, corner.reshape(-1, 9), "f %d/%d/%d %d/%d/%d %d/%d/%d")
    target.write_text(text.getvalue(), encoding="ascii")
    material.write_text(f"newmtl scan\nKd 1 1 1\nKs 0 0 0\nmap_Kd {picture.name}\n")
    picture.write_bytes(cv2.imencode(".png", scan.texture[..., ::-1])[1].tobytes())
    return [target, material, picture]
