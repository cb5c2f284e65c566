"""The scene that a person has dropped on the page, in the place of the settings' one, until another is chosen or the run ends."""

import sys
from pathlib import Path

import msgspec

from vemlight.errors import UserError
from vemlight.files import written_whole
from vemlight.renderer.scene.upload_check import SCENE_FILE
from vemlight.renderer.stage import RendererStage, SceneChosen
from vemlight.runtime.announcement import Announcement
from vemlight.runtime.loop import run_stage
from vemlight.runtime.session import session_folder, upload_folder
from vemlight.settings import Settings

CHOICE = "scene"  # file of the session: the number of the upload, so that a renderer that was restarted begins with it


def run_renderer(settings: Settings, restarts: int) -> None:
    """Runs the renderer, with one stage after the other as scenes are chosen."""
    folder = session_folder()
    number = (folder / CHOICE).read_text() or None if folder and (folder / CHOICE).is_file() else None
    while True:
        stage = _stage(settings, number)
        try:
            run_stage(settings, stage, restarts, Announcement("scene", stage.scene_message) if "viewer" in settings.services else None)
            return
        except SceneChosen as chosen:
            number = chosen.number
            if folder:
                _keep(folder / CHOICE, number)
            stage.release()


def _keep(path: Path, number: str | None) -> None:
    """Writes down which scene is chosen; where the disk refuses, a line says what that means."""
    try:
        with written_whole(path) as part:
            part.write_text(number or "")
    except OSError as error:
        text = f"the choice of a scene is not kept ({error.strerror}): a renderer that is restarted begins with the one before; make room"
        print(f"vemlight: renderer: {path}: {text}", file=sys.stderr, flush=True)


def _stage(settings: Settings, number: str | None) -> RendererStage:
    """The stage with the scene that is chosen; with the settings' one, and a line, where that cannot be drawn."""
    if number and (files := upload_folder(number)):
        try:
            drawing = msgspec.structs.replace(settings.renderer, scene=str(files / SCENE_FILE), camera=None, poses=())
            return RendererStage(msgspec.structs.replace(settings, renderer=drawing), number)
        except UserError as error:
            print(f"vemlight: {error}; the scene stays", file=sys.stderr, flush=True)
    return RendererStage(settings, number)
