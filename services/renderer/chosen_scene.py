"""The scene that a person has dropped on the page, in the place of the settings' one, until another is chosen or the run ends."""

import sys

import msgspec

from vemlight.errors import UserError
from vemlight.renderer.scene.upload_check import SCENE_FILE
from vemlight.renderer.stage import RendererStage, SceneChosen
from vemlight.runtime.announcement import Announcement
from vemlight.runtime.loop import run_stage
from vemlight.runtime.session import session_folder, upload_folder
from vemlight.settings import Settings

CHOICE = "scene"  # file of the session: the number of the upload, so that a renderer that was restarted begins with it


def run_renderer(settings: Settings, restarts: int) -> None:
    """Runs the renderer, with one stage after the other as scenes are chosen."""
    while True:
        stage = _stage(settings)
        try:
            run_stage(settings, stage, restarts, Announcement("scene", stage.scene_message) if "viewer" in settings.services else None)
            return
        except SceneChosen as chosen:
            if folder := session_folder():
                (folder / CHOICE).write_text(chosen.number or "")
            stage.release()


def _stage(settings: Settings) -> RendererStage:
    """The stage with the scene that is chosen; with the settings' one, and a line, where that cannot be drawn."""
    folder = session_folder()
    number = (folder / CHOICE).read_text() or None if folder and (folder / CHOICE).is_file() else None
    if number and (files := upload_folder(number)):
        try:
            drawing = msgspec.structs.replace(settings.renderer, scene=str(files / SCENE_FILE), camera=None, poses=())
            return RendererStage(msgspec.structs.replace(settings, renderer=drawing), number)
        except UserError as error:
            print(f"vemlight: {error}; the scene stays", file=sys.stderr, flush=True)
    return RendererStage(settings, number)
