"""The capture process: `python -m vemlight.capture [vemlight.toml [NAME]]`, with the name of its camera where a rig has several."""

import sys

import msgspec

from vemlight.capture.choosing import ChosenSources
from vemlight.capture.stage import CaptureCamera, CaptureSource
from vemlight.runtime.instances import camera_capture, instance_of
from vemlight.runtime.source_loop import run_camera, run_host, run_source
from vemlight.runtime.start import start
from vemlight.settings import Settings
from vemlight.source_names import is_live


def main(settings: Settings, restarts: int = 0, camera: str = "") -> None:
    in_rig = bool(settings.rig.file or camera)
    capture = camera_capture(settings, camera) if in_rig else settings.capture
    name = f"capture.{camera}" if in_rig else instance_of(settings, "capture")
    if not in_rig and settings.mode == "live":
        run_host(settings, ChosenSources(settings, name), name, restarts)
    elif is_live(capture.source):
        run_camera(settings, CaptureCamera(capture, name), restarts)
    else:
        run_source(settings, CaptureSource(msgspec.structs.replace(settings, capture=capture), name), restarts, in_step=in_rig)


if __name__ == "__main__":
    sys.exit(start(main, sys.argv[1:]))
