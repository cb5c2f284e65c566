"""`vemlight export`: lights of a file or a source as USD, glTF and MCAP, in one pass."""

from collections.abc import Iterator
from contextlib import ExitStack
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from vemlight.commands.options import ExportOptions
from vemlight.commands.report import Report
from vemlight.errors import UserError
from vemlight.exchange.gltf_lights import gltf_from_lights, write_gltf
from vemlight.exchange.mcap_file import mcap_recording
from vemlight.exchange.usd_file import UsdStage
from vemlight.files import notice
from vemlight.light.as_directional import as_directional
from vemlight.light.light_set import lights_json, lights_row
from vemlight.light.lights_reader import LightsFrame, is_lights_file, lights_frames
from vemlight.runtime.interrupt import interruption
from vemlight.runtime.progress import awaited, counted

if TYPE_CHECKING:  # what reads and samples maps is imported where there are any: it takes longer than exporting a minute of lights
    from vemlight.capture.frames import Frame
    from vemlight.commands.residual import Residual


class ToExport(NamedTuple):
    """A frame of lights; of a source also its map."""

    lights: LightsFrame
    map: "Frame | None" = None

    @property
    def scale(self) -> float | None:
        """cd/m2 per unit, where it is known."""
        return self.map.luminance_scale if self.map else None


def export_lights(options: ExportOptions) -> Report:
    """Writes what is asked for, and nothing when anything is wrong. Raises UserError."""
    _check(options)
    with ExitStack() as open_:
        stage = _Stage(options, open_) if options.usd else None
        mcap = open_.enter_context(mcap_recording(options.mcap)) if options.mcap else None
        chosen: ToExport | None = None
        count = 0
        for count, frame in enumerate(_frames(options, open_), 1):
            interruption.check()
            if stage:
                stage.add(frame)
            if mcap:
                mcap.add(frame.lights.schema, frame.lights.sequence, frame.lights.time_s, frame.lights.row_json)
            if options.gltf and count == options.frame + 1:
                chosen = frame
                if not (stage or mcap):
                    break
        texts, values = [], {"frames": count}
        if options.gltf:
            if chosen is None:
                raise UserError(f"--frame {options.frame}: {options.source} has {count} frames, the first is 0; choose one of them")
            of_frame = chosen.lights
            document = gltf_from_lights(of_frame.lights, of_frame.sequence, of_frame.time_s, chosen.scale, of_frame.near)
            write_gltf(options.gltf, document)
            points = f" and {len(of_frame.near.points.ids)} near lights" if of_frame.near else ""
            texts.append(f"{options.gltf}: {len(of_frame.lights.ids)} lights{points} of frame {options.frame}")
        if stage:
            values["lights"] = stage.write()
            texts.append(f"{options.usd}: {values['lights']} lights in {_counted(count)}")
    if mcap:
        texts.append(f"{options.mcap}: {_counted(count)}")
    outputs = {kind: str(path) for kind, path in (("usd", options.usd), ("gltf", options.gltf), ("mcap", options.mcap)) if path}
    return Report("\n".join(texts), {**outputs, **values})


def _counted(frames: int) -> str:
    return f"{frames} frame{'' if frames == 1 else 's'}"


def _check(options: ExportOptions) -> None:
    if not (options.usd or options.gltf or options.mcap):
        raise UserError("--usd, --gltf, --mcap: none is given; name a file to write")
    if options.residual and not options.usd:
        raise UserError("--residual: is a part of a USD stage; add --usd OUT.usda")
    if not is_lights_file(options.source):
        return
    if options.given:
        raise UserError(f"{options.given[0]}: {options.source} has its lights already; leave it out, or give the source of the lights")
    if options.residual:
        raise UserError(f"--residual: {options.source} holds lights and no map; give the source that they were made from")


def _frames(options: ExportOptions, open_: ExitStack) -> Iterator[ToExport]:
    """The frames of the file or source, with progress."""
    if is_lights_file(options.source):
        open_.enter_context(awaited(f"frames of {options.source}"))
        for frame in islice(lights_frames(Path(options.source)), options.frames):
            yield ToExport(frame)
        return
    from vemlight.commands.lighting import lit_frames
    from vemlight.commands.offline import open_frames, sampler_settings

    frames = open_frames(options)
    sampling = sampler_settings(options, len(frames), error_percent=options.error_percent, soft=options.soft)
    for k, ((frame, lights, error), _) in enumerate(counted(lit_frames(frames, sampling), "frames", len(frames))):
        row = lights_row(lights, k, frame.time_s, frame.coverage, error, frame.clipped, estimated_lux=frame.estimated_lux)
        yield ToExport(LightsFrame(row.schema, k, frame.time_s, frame.coverage, lights, lights_json(row)), frame)


class _Stage:
    """The USD stage, made when the first frame says in which unit."""

    def __init__(self, options: ExportOptions, open_: ExitStack) -> None:
        assert options.usd
        self._path, self._options, self._open = options.usd, options, open_
        self._usd: Any = None
        self._folder: Path | None = None
        self._residual: Residual | None = None
        if options.residual:
            from vemlight.commands.residual import residual_folder

            self._folder = open_.enter_context(residual_folder(options.usd))

    def add(self, frame: ToExport) -> None:
        if self._usd is None:
            self._usd = UsdStage(self._path, self._options.usd_dialect, frame.scale)
            self._open.enter_context(self._usd.columns)
            if self._folder:
                from vemlight.commands.residual import Residual

                self._residual = Residual(self._folder, frame.scale)
        elif frame.scale != self._usd.scale:
            raise UserError(
                f"frame {frame.lights.sequence}: has a luminance scale of {frame.scale} and the first one of {self._usd.scale}; "
                "export frames of one scale"
            )
        near = frame.lights.near
        if near and len(near.points.ids):
            x, y, z = near.at
            notice(f"--usd: near lights are directional there, as they are seen from {x:g}, {y:g}, {z:g} m; --gltf has them as points")
        lights = as_directional(frame.lights.lights, near)
        if self._residual and frame.map:
            lights = self._residual.take(lights, frame.map)
        self._usd.columns.add(lights, frame.lights.time_s)

    def write(self) -> int:
        """How many lights it has."""
        self._usd.dome = self._residual.dome if self._residual else None
        return self._usd.write()
