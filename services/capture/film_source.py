"""A film's pictures by number, each made into a polar map of radiance."""

from pathlib import Path
from typing import Any

from vemlight.capture.colour_coding import STILL, VIDEO, ColourCoding, colour_coding
from vemlight.capture.frames import Frame, FrameMaker
from vemlight.capture.planes import Planes, planes_from_video_frame
from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.light.film_file import FilmFile, film_stereo, film_tags
from vemlight.settings import Capture


class FilmSource:
    """A film from [capture] start to end at its speed; see `vemlight.capture.source.FrameSource`."""

    def __init__(self, settings: Capture, path: Path) -> None:
        """Raises UserError for a film that cannot be used, and when start and end leave nothing."""
        self._film, self._settings = FilmFile(path), settings
        end = min(settings.end or len(self._film), len(self._film))
        if settings.start >= end:
            frames = f"frames 0 to {len(self._film) - 1}, of which [capture] start and end leave none"
            raise UserError(f"{path}: has {frames}; correct them")
        self._numbers = range(settings.start, end)
        self._path, self._maker = path, FrameMaker(settings, path.parent)
        self._pictures = PictureMaker(settings, self._maker, str(path))
        self.fps = self._film.fps * settings.speed

    def __len__(self) -> int:
        return len(self._numbers)

    def paths(self, k: int) -> tuple[Path, ...]:
        return (self._path,)

    @property
    def calibration(self) -> tuple[Path, ...]:
        return self._maker.files

    def check(self) -> None:
        """Raises UserError for a first frame from which no map can be made."""
        self.frame(0)

    def frame(self, k: int) -> Frame:
        """Frame k of 0 .. len - 1. Raises UserError for one that is damaged or of another size."""
        number = self._numbers[k]
        time_s = (self._film.time_s(number) - self._film.time_s(self._numbers[0])) / self._settings.speed
        return self._pictures.frame(self._film.frame(number), time_s, self._film.is_still_codec)


class PictureMaker:
    """Makes polar maps of decoded pictures; the first one decides how colours are read."""

    def __init__(self, settings: Capture, maker: FrameMaker, name: str) -> None:
        """name: of the film or stream, for notices and errors."""
        self._settings, self._maker, self._name = settings, maker, name
        self._coding: ColourCoding | None = None
        self._read_as: tuple[Any, ...] = ()

    def frame(self, picture: Any, time_s: float, is_still_codec: bool) -> Frame:
        """The frame of an av.VideoFrame. Raises UserError for pixels, colours or a size that cannot be used."""
        planes = planes_from_video_frame(self._name, picture)
        if stereo := self._settings.stereo or film_stereo(picture):
            notice(f"{self._name}: is for two eyes, {stereo}; the first one is taken")
            planes = first_eye(planes, stereo)
        tags = film_tags(picture)
        if planes.layout.is_rgb:  # gray, too, which has no matrix and may have either range
            is_gray = planes.layout.components[0] == planes.layout.components[1]
            tags = tags._replace(matrix="rgb", range=tags.range or (None if is_gray else "full"))
        if self._coding is None or self._read_as != (tags, planes.layout):
            if self._coding is None and picture.rotation:
                notice(f"{self._name}: says that it is to be turned by {picture.rotation} degrees; pixels stay where the sensor has them")
            if self._coding is None and picture.interlaced_frame:
                notice(f"{self._name}: is interlaced; both fields are taken as one picture")
            self._coding = colour_coding(self._settings, self._name, tags, STILL if is_still_codec else VIDEO, self._maker.response)
            self._read_as = tags, planes.layout
        return self._maker.frame_from_planes(self._name, planes, self._coding, time_s)


def first_eye(planes: Planes, stereo: str) -> Planes:
    """The upper half of a picture "top-bottom", or the left one "side-by-side"."""
    if stereo == "top-bottom":
        return planes._replace(height=planes.height // 2)
    return planes._replace(width=planes.width // 2)
