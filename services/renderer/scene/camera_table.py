"""The camera of a scene file: `[camera]` with its place, or with the name of a camera in one of the scene's glTF files."""

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta

from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.renderer.scene.gltf_cameras import FileCamera
from vemlight.renderer.scene.luminaire_table import MAX_COORDINATE_M, Vector
from vemlight.renderer.scene.scene_limits import MAX_VIEWS
from vemlight.runtime.poses import View

MIN_VIEW_M = 1e-9  # between the camera and what it looks at; any value in 1e-12 .. 1e-6 does
MAX_ROLL_DEG = 0.5  # by which a file's camera may be tilted without a word; 0.1 to 1 do
FOV_Y_DEG = 40.0
FieldOfView = Annotated[float, Meta(gt=0, lt=180)]
ViewAngle = Annotated[float, Meta(ge=1, le=170)]  # of View


class ViewCamera(msgspec.Struct, frozen=True, kw_only=True):
    """The pinhole camera that the scene is seen through. position and at are points in the world; fov_y: degrees, lower to upper edge."""

    position: Vector
    at: Vector
    fov_y: float = FOV_Y_DEG


class CameraTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[camera]` of a scene file: `from` and `at`, or `preset`, the name of a camera in one of its glTF files."""

    position: Vector | None = msgspec.field(name="from", default=None)
    at: Vector | None = None
    fov_y: FieldOfView | None = None
    preset: Annotated[str, Meta(max_length=200)] = ""


class ViewTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """`[[view]]` of a scene file: another place to look from, by its name."""

    name: Annotated[str, Meta(min_length=1, max_length=64)]
    position: Vector = msgspec.field(name="from")
    at: Vector
    fov_y: ViewAngle = FOV_Y_DEG


class PlacedCamera(NamedTuple):
    """A camera of a file in the scene."""

    camera: FileCamera
    world_from_file: np.ndarray


def view_camera(table: CameraTable, cameras: Sequence[PlacedCamera], path: Path) -> ViewCamera:
    """The camera of a scene. cameras: those of its files. Raises UserError that names the scene file `path`."""
    if table.preset:
        if table.position or table.at:
            raise UserError(f"{path}: [camera] has preset as well as from and at; leave one of the two out")
        camera = _of_preset(table, cameras, path)
    elif table.position is None or table.at is None:
        raise UserError(f"{path}: [camera] needs from and at, or preset; {_choices(cameras)}")
    else:
        camera = ViewCamera(position=table.position, at=table.at, fov_y=table.fov_y or FOV_Y_DEG)
    points = np.array([camera.position, camera.at])
    if not np.abs(points).max() <= MAX_COORDINATE_M or np.abs(points[0] - points[1]).max() <= MIN_VIEW_M:
        raise UserError(f"{path}: [camera] from and at must be two different points within {MAX_COORDINATE_M:.0f} m; correct them")
    return camera


def named_views(tables: Sequence[ViewTable], cameras: Sequence[PlacedCamera], path: Path) -> tuple[tuple[str, View], ...]:
    """The places to look from that a page offers: those of `[[view]]`, then the cameras of the scene's files that have perspective.

    Raises UserError that names the scene file `path` for names that are equal, and for a view of no length.
    """
    views: dict[str, View] = {}
    for number, table in enumerate(tables, 1):
        where = f"{path}: [[view]] {number}"
        if table.name in views:
            raise UserError(f"{where}: {table.name} is the name of an earlier one; give each its own")
        try:
            views[table.name] = msgspec.convert({"from": table.position, "at": table.at, "fov_y": table.fov_y}, View)
        except msgspec.ValidationError as error:
            raise UserError(f"{where}: {error}; correct it") from error
    for placed in cameras:
        name = placed.camera.name[:64]
        if name and name not in views and placed.camera.fov_y_deg is not None:
            if len(views) == MAX_VIEWS:
                notice(f"{path}: {MAX_VIEWS} views are offered, and the scene's files have more cameras; name those you want as [[view]]")
                break
            with contextlib.suppress(UserError, msgspec.ValidationError):  # one that looks nowhere is offered to nobody
                camera = _of_preset(CameraTable(preset=placed.camera.name), [placed], path, quiet=True)
                views[name] = msgspec.convert({"from": camera.position, "at": camera.at, "fov_y": camera.fov_y}, View)
    return tuple(views.items())


def _of_preset(table: CameraTable, cameras: Sequence[PlacedCamera], path: Path, quiet: bool = False) -> ViewCamera:
    found = next((placed for placed in cameras if placed.camera.name == table.preset), None)
    if found is None:
        raise UserError(f"{path}: [camera] preset = {table.preset[:60]}: no glTF file of the scene has it; {_choices(cameras)}")
    if found.camera.fov_y_deg is None:
        raise UserError(f"{path}: [camera] preset = {table.preset[:60]}: has no perspective; choose a camera that has")
    matrix = found.world_from_file @ found.camera.file_from_camera
    position, forward, up = matrix[:3, 3], -matrix[:3, 2], matrix[:3, 1]
    length = float(np.linalg.norm(forward))
    if not (np.isfinite(matrix).all() and length > 0):
        raise UserError(f"{path}: [camera] preset = {table.preset[:60]}: looks nowhere; correct its node")
    forward = forward / length
    level = np.cross(forward, [0.0, 0.0, 1.0])
    if not quiet and (across := float(np.linalg.norm(level))) > np.sin(np.radians(MAX_ROLL_DEG)):
        roll_deg = np.degrees(np.arctan2(up @ level / across, up @ np.cross(level / across, forward)))
        if abs(roll_deg) > MAX_ROLL_DEG:
            notice(f"{path}: [camera] {table.preset[:60]}: its roll of {roll_deg:.1f} degrees is not drawn")
    if found.camera.moves and not quiet:
        notice(f"{path}: [camera] {table.preset[:60]}: its animation is not followed")
    x, y, z = position.tolist()
    at_x, at_y, at_z = (position + forward).tolist()
    return ViewCamera(position=(x, y, z), at=(at_x, at_y, at_z), fov_y=table.fov_y or found.camera.fov_y_deg)


def _choices(cameras: Sequence[PlacedCamera]) -> str:
    names = ", ".join(dict.fromkeys(placed.camera.name for placed in cameras))
    return f"its cameras are {names[:200]}" if names else "no file of the scene has cameras"
