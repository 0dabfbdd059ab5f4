"""One persistent Mitsuba scene per structure, updated per sample so that nothing recompiles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from synthgen.errors import RenderError
from synthgen.geometry.cameras import Camera
from synthgen.geometry.transforms import look_at
from synthgen.models import ManoModel
from synthgen.render import backend, background
from synthgen.render.skin import material
from synthgen.scene import AreaLight, HandSubject, Scene
from synthgen.scene.relief import relief_of
from synthgen.scene.surface import DrawnSurface

Array = NDArray[np.float64]

# Mitsuba's cameras look along +z with +x to the left and +y up; ours are OpenCV's.
_FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Solid:
    """A triangle mesh as it stands in the scene: float32 values, kept in float64.

    ``normals`` (V, 3) are unit vertex normals, or None for flat faces.
    """

    vertices: Array
    triangles: NDArray[np.int64]
    normals: Array | None


class LiveScene:
    """The uploaded scene of one structure: which hands, how many lamps, which picture size.

    Parameters
    ----------
    models : tuple of ManoModel
        One per subject, in order.
    n_lamps : int
        Number of area lights.
    width, height : int
        Pixels.
    quality : {"plain", "full"}
        Of the skin's material.
    """

    def __init__(
        self,
        models: tuple[ManoModel, ...],
        n_lamps: int,
        width: int,
        height: int,
        quality: str = "plain",
    ):
        self.models = models
        self.quality = quality
        self.drawn = tuple(DrawnSurface.for_model(model) for model in models)
        self.n_lamps = n_lamps
        self._mi: Any = backend.mitsuba()
        self._scene = self._load(width, height)
        self._params = self._mi.traverse(self._scene)
        self.solids: list[Solid] = []
        self.lamps: list[Array] = []
        self._skins: list[Any] = [None] * len(models)
        self._wall: Any = None
        self._shapes = {shape.id(): shape for shape in self._scene.shapes()}

    @property
    def scene(self) -> Any:
        """The Mitsuba scene."""
        return self._scene

    def shape(self, name: str) -> Any:
        """Return an uploaded shape: ``hand0``..., ``wall`` or ``lamp0``..."""
        return self._shapes[name]

    def _load(self, width: int, height: int) -> Any:
        mi = self._mi
        description: dict[str, Any] = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3},
            "sensor": {
                "type": "perspective",
                "fov": 40.0,
                "fov_axis": "x",
                "near_clip": 0.01,
                "far_clip": 100.0,
                "film": {
                    "type": "hdrfilm",
                    "width": width,
                    "height": height,
                    "pixel_format": "rgb",
                    "component_format": "float32",
                    "rfilter": {"type": "box"},
                },
                "sampler": {"type": "independent"},
            },
            "surround": {"type": "constant", "radiance": {"type": "rgb", "value": [0.5] * 3}},
        }
        for k, drawn in enumerate(self.drawn):
            description[f"hand{k}"] = self._mesh(
                f"hand{k}", len(drawn.uv), drawn.triangles, drawn.uv,
                material.describe(mi, self.quality), True,
            )  # fmt: skip
        wall_uv = np.zeros((4 * background.QUADS, 2), dtype=np.float32)
        description["wall"] = self._mesh(
            "wall", len(wall_uv), background.wall_triangles(), wall_uv, _wall_material(mi), False
        )
        for k in range(self.n_lamps):
            description[f"lamp{k}"] = {
                "type": "rectangle",
                "to_world": mi.ScalarTransform4f().translate([0, 3 + k, 0]),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}},
            }
        return mi.load_dict(description)

    def _mesh(
        self, name: str, n: int, triangles: NDArray[np.uint32], uv: NDArray[np.float32],
        material: dict[str, Any], smooth: bool,
    ) -> Any:  # fmt: skip
        mi = self._mi
        properties = mi.Properties()
        properties["mesh_bsdf"] = mi.load_dict(material)
        mesh = mi.Mesh(
            name, n, len(triangles), has_vertex_normals=smooth, has_vertex_texcoords=True,
            props=properties,
        )  # fmt: skip
        params = mi.traverse(mesh)
        params["faces"] = triangles.ravel()
        params["vertex_positions"] = np.zeros(3 * n, dtype=np.float32)
        params["vertex_texcoords"] = _flip_v(uv)
        params.update()
        mesh.set_id(name)
        return mesh

    def update(self, scene: Scene, surfaces: list[NDArray[np.float32]]) -> None:
        """Put a sample into the scene.

        Parameters
        ----------
        scene : Scene
        surfaces : list of (S, 3)
            Posed surface vertices per subject, world, metres.
        """
        self.solids = []
        for k, (subject, vertices) in enumerate(zip(scene.subjects, surfaces, strict=True)):
            self._put_hand(k, subject, vertices)
        self._put_wall(scene)
        self._params["surround.radiance.value"] = self._colour(scene.lights.constant_rgb)
        self.lamps = []
        for k, lamp in enumerate(scene.lights.area):
            self._put_lamp(k, lamp)
        self._params.update()

    def _put_hand(self, k: int, subject: HandSubject, surface: NDArray[np.float32]) -> None:
        drawn, model, name = self.drawn[k], self.models[k], f"hand{k}"
        relief = relief_of(model, subject.skin, np.array(subject.pose))
        vertices, normals = drawn.draw(surface, relief)
        self._params[f"{name}.vertex_positions"] = vertices.ravel()
        self._params[f"{name}.vertex_normals"] = normals.ravel()
        if self._skins[k] != subject.skin:
            self._skins[k] = subject.skin
            self._fill(f"{name}.bsdf", material.of_skin(model, subject.skin, self.quality))
        self._fill(f"{name}.bsdf", material.of_pose(model, subject, self.quality))
        self.solids.append(
            Solid(vertices.astype(float), drawn.triangles.astype(np.int64), normals.astype(float))
        )

    def _put_wall(self, scene: Scene) -> None:
        corners, uv = background.wall_geometry(scene.background, scene.cameras[0])
        corners = corners.astype(np.float32)
        self._params["wall.vertex_positions"] = corners.ravel()
        self._params["wall.vertex_texcoords"] = _flip_v(uv)
        if self._wall != scene.background and scene.background.kind != "empty":
            self._wall = scene.background
            texture = background.wall_texture(scene.background)
            key = "wall.bsdf.brdf_0.reflectance.data"
            self._params[key] = self._mi.TensorXf(texture)
        triangles = background.wall_triangles().astype(np.int64)
        self.solids.append(Solid(corners.astype(float), triangles, None))

    def _put_lamp(self, k: int, lamp: AreaLight) -> None:
        position, target = np.array(lamp.position_m), np.array(lamp.target_m)
        up = (0.0, 1.0, 0.0) if abs(_unit(target - position)[1]) < 0.99 else (1.0, 0.0, 0.0)
        frame = look_at(position, target, up)
        self.lamps.append(frame)
        matrix = frame @ np.diag([lamp.size_m / 2] * 2 + [1.0, 1.0])
        self._params[f"lamp{k}.to_world"] = self._transform(matrix)
        self._params[f"lamp{k}.emitter.radiance.value"] = self._colour(lamp.radiance_rgb)

    def _fill(self, prefix: str, values: material.Values) -> None:
        for key, value in values.items():
            number = isinstance(value, float)
            self._params[f"{prefix}.{key}"] = (
                self._number(value) if number else self._mi.TensorXf(value)
            )

    def _number(self, value: float) -> Any:
        """Pass a number as data: a literal would be compiled into the kernels."""
        return backend.drjit().opaque(self._mi.Float, float(value))

    def _transform(self, matrix: Array) -> Any:
        transform = self._mi.Transform4f(matrix.astype(np.float32))
        backend.drjit().make_opaque(transform)
        return transform

    def _colour(self, rgb: tuple[float, float, float]) -> Any:
        return self._mi.Color3f(*(self._number(value) for value in rgb))

    def radiance(self, camera: Camera, spp: int, max_depth: int, seed: int) -> NDArray[np.float32]:
        """Path-trace one view; (H, W, 3) float32, linear sRGB."""
        mi = self._mi
        _require_centred(camera)
        fov = float(2 * np.rad2deg(np.arctan(camera.width / 2 / camera.fx)))
        self._params["sensor.x_fov"] = self._number(fov)
        self._params["sensor.to_world"] = self._transform(camera.T @ _FLIP)
        self._params.update()
        integrator = mi.load_dict({"type": "path", "max_depth": max_depth})
        key = backend.drjit().opaque(mi.UInt32, seed)
        image = mi.render(self._scene, integrator=integrator, spp=spp, seed=key)
        return np.array(image, dtype=np.float32)


def _unit(v: Array) -> Array:
    return v / np.linalg.norm(v)


def _flip_v(uv: NDArray[np.float32]) -> NDArray[np.float32]:
    """Mitsuba samples bitmaps with the first row at v = 0 for meshes filled by hand."""
    flipped = uv.copy()
    flipped[:, 1] = 1 - flipped[:, 1]
    return flipped.ravel()


def _wall_material(mi: Any) -> dict[str, Any]:
    n = background.TEXTURE_PX
    texture = np.full((n, n, 3), 0.4, dtype=np.float32)
    brdf = {"type": "diffuse", "reflectance": _bitmap(mi, texture, "repeat")}
    return {"type": "twosided", "brdf": brdf}


def _bitmap(mi: Any, texture: NDArray[np.float32], wrap: str) -> dict[str, Any]:
    return {
        "type": "bitmap",
        "bitmap": mi.Bitmap(texture),
        "filter_type": "bilinear",
        "wrap_mode": wrap,
        "raw": True,
    }


def _require_centred(camera: Camera) -> None:
    centred = np.allclose(
        [camera.cx, camera.cy], [camera.width / 2 - 0.5, camera.height / 2 - 0.5], atol=1e-6
    )
    if any(camera.distortion) or camera.fx != camera.fy or not centred:
        raise RenderError(
            f"camera fx={camera.fx} fy={camera.fy} cx={camera.cx} cy={camera.cy} distortion="
            f"{camera.distortion}: quality 'plain' renders square pixels, a centred principal "
            "point and no distortion"
        )
