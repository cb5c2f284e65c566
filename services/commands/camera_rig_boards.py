"""`vemlight calibrate rig --board`: where cameras stand, from photographs of a board that they took at the same moments."""

import re
from pathlib import Path

from scipy.spatial.transform import Rotation

from vemlight.capture.calibration.board_pose import pose_from_rays
from vemlight.capture.calibration.boards import BoardView, CalibrationBoard, check_board, read_views
from vemlight.capture.lens import direction_from_pixel, read_lens
from vemlight.errors import UserError, of_setting
from vemlight.files import notice
from vemlight.fuse.board_poses import BoardFit, Pose, Sight, poses_from_boards
from vemlight.fuse.bundle_adjustment import CalibrationError, Poses
from vemlight.fuse.rig_file import CameraRig, RigCamera

PHOTOGRAPHS = (".png", ".jpg", ".jpeg", ".tif", ".tiff")


def poses_from_photographs(path: Path, rig: CameraRig, start: Poses, folder: Path, board: CalibrationBoard) -> BoardFit:
    """The poses by folder/NAME/ of each camera of the rig file `path`: the n-th photographs of all, by their names, are of one moment.

    Raises UserError for a folder, a photograph or a lens that cannot be used, and for boards from which no poses follow.
    """
    check_board(board)
    taken = {camera.name: _photographs(folder, camera) for camera in rig.camera}
    counts = {name: len(paths) for name, paths in taken.items()}
    if len(set(counts.values())) > 1:
        shown = ", ".join(f"{name} {count}" for name, count in counts.items())
        raise UserError(f"{folder}: the cameras have different numbers of photographs ({shown}); keep one of each camera for each moment")
    seen = []
    for camera in rig.camera:
        with of_setting(f"{path}: camera {camera.name}"):
            seen.append(_sights(camera, taken[camera.name], board))
    try:
        return poses_from_boards(seen, start, [camera.name for camera in rig.camera])
    except CalibrationError as error:
        raise UserError(f"{path}: {error}") from error


def _photographs(folder: Path, camera: RigCamera) -> list[Path]:
    own = folder / camera.name
    if not own.is_dir():
        raise UserError(f"{own}: there is no such folder; --views names one that has a folder of photographs for each camera, by its name")
    found = [path for path in own.iterdir() if path.suffix.lower() in PHOTOGRAPHS and not path.name.startswith(".")]
    if not found:
        raise UserError(f"{own}: holds no photographs; put some of the board there ({', '.join(PHOTOGRAPHS)})")
    return sorted(found, key=_by_numbers)


def _by_numbers(path: Path) -> tuple[list[str], list[int], str]:
    """Orders names by their numbers: IMG_9 before IMG_10."""
    parts = re.split(r"(\d+)", path.stem)
    return parts[::2], [int(digits) for digits in parts[1::2]], path.name


def _sights(camera: RigCamera, paths: list[Path], board: CalibrationBoard) -> list[Sight | None]:
    """The board in each photograph of a camera, None where it was not found."""
    if not camera.lens:
        raise UserError("has no lens; calibrate it (vemlight calibrate lens), and name its file as `lens`")
    lens = read_lens(Path(camera.lens))
    views = read_views(paths, board)
    if views.size != lens.size:
        sizes = f"are {views.size[0]}x{views.size[1]}, and {Path(camera.lens).name} is of {lens.size[0]}x{lens.size[1]}"
        raise UserError(f"its photographs {sizes}; take them in the format of the lens file")
    if views.without_board:
        notice(f"{camera.name}: no board was found in {', '.join(views.without_board)}; the other {len(views.views)} are used")
    found = {view.name: view for view in views.views}

    def sight(view: BoardView) -> Sight:
        rays = direction_from_pixel(view.pixels, lens) @ lens.rotation.T
        pose, _ = pose_from_rays(rays, view.points)
        return Sight(rays, view.points, Pose(Rotation.from_rotvec(pose[:3]).as_matrix(), pose[3:]), whole=not board.dictionary)

    return [sight(found[path.name]) if path.name in found else None for path in paths]
