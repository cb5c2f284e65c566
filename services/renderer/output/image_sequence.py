"""The pictures of a run as files: frame_0000.exr (linear) and .png (tone-mapped), a manifest, a contact sheet and a video of them."""

from pathlib import Path

import numpy as np

from vemlight.choices import ExrFloats
from vemlight.errors import UserError
from vemlight.files import notice
from vemlight.light.images import write_exr, write_png
from vemlight.renderer.output.exr_attributes import exr_pixels, time_attributes
from vemlight.renderer.output.tonemap import Adaptation
from vemlight.renderer.output.video import BACKGROUND, over_background, video_writer
from vemlight.runtime import stamps
from vemlight.runtime.output_folder import CONTACT_SHEET, RunManifest, WrittenPicture, run_start
from vemlight.runtime.progress import counted
from vemlight.settings import Settings

CONTACT_SHEET_COLUMNS = 6
CONTACT_SHEET_PICTURES = 24
THUMBNAIL_WIDTH = 320  # pixels; 6 of them make 1920
DEFAULT_FPS = 25.0  # of a video of one picture, whose time steps say no rate


class PictureEntry(WrittenPicture, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A line of manifest.jsonl. adaptation: the tone mapping's after this picture, from which a renderer that was killed goes on."""

    adaptation: Adaptation


class ImageSequenceWriter:
    """Writes numbered pictures to a folder, in order, and goes on after those that a run with the same settings and inputs left there."""

    def __init__(self, settings: Settings) -> None:
        """Raises UserError when the folder `settings.out` cannot be written, is in use, or holds the output of another run."""
        self._folder = Path(settings.out)
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._manifest = RunManifest(self._folder, run_start(settings), PictureEntry)
        except OSError as error:
            raise UserError(f"{error.filename or self._folder}: cannot be written ({error.strerror}); choose another --out") from error
        self._floats: ExrFloats = settings.renderer.exr
        self._is_live = settings.mode == "live"
        self._renumbered = 0  # live: added to the numbers of a source that was restarted and counts from 0 again

    @property
    def count(self) -> int:
        return len(self._manifest.pictures)

    @property
    def last(self) -> PictureEntry | None:
        return self._manifest.pictures[-1] if self._manifest.pictures else None

    def add(self, picture: np.ndarray, pixels: np.ndarray, stamp: stamps.Stamp, adaptation: Adaptation) -> None:
        """Writes one frame: `picture` (height, width, 4) float32, linear, and `pixels`, the same tone-mapped, uint8.

        The manifest names it once its files are on the disk. Raises OSError when the disk refuses; nothing of it is then there.
        """
        if self.last and stamp.sequence + self._renumbered <= self.last.sequence:
            self._renumbered = self.last.sequence + 1 - stamp.sequence
        sequence = stamp.sequence + self._renumbered
        exr = self._folder / f"frame_{sequence:04d}.exr"
        try:
            write_exr(exr, exr_pixels(picture, self._floats), time_attributes(sequence, stamp.time_s, captured_ns=self._captured_ns(stamp)))
            write_png(exr.with_suffix(".png"), pixels)
            sha256, png_sha256 = self._manifest.digests(exr.name)
            self._manifest.add(
                PictureEntry(
                    name=exr.name,
                    sequence=sequence,
                    time_s=stamp.time_s,
                    sha256=sha256,
                    png_sha256=png_sha256,
                    adaptation=adaptation,
                )
            )
        except OSError:
            exr.unlink(missing_ok=True)
            exr.with_suffix(".png").unlink(missing_ok=True)
            raise

    def _captured_ns(self, stamp: stamps.Stamp) -> int | None:
        """When a live picture's light was seen. In lossless mode a stamp says when a file was read, which differs from run to run."""
        return stamp.captured_ns if self._is_live else None

    def complete(self, video: Path | None = None) -> None:
        """Writes the contact sheet and the video, if there is any picture, and the manifest's last line.

        Raises OSError when the disk refuses.
        """
        if self.count:
            self.write_contact_sheet()
            if video:
                self.write_video(video)
        self._manifest.complete()

    def close(self) -> None:
        """Lets another process write there."""
        self._manifest.close()

    def write_contact_sheet(self) -> None:
        """Writes a contact sheet of all pictures."""
        write_contact_sheet(self._folder / CONTACT_SHEET, [self._folder / entry.name for entry in self._manifest.pictures])

    def write_video(self, path: Path) -> None:
        """Writes all pictures as a video, read back from their files, so that restarts of the renderer do not show in it."""
        steps_s = np.diff([entry.time_s for entry in self._manifest.pictures])
        steps_s = steps_s[steps_s > 0]
        with video_writer(path, 1 / float(np.median(steps_s)) if len(steps_s) else DEFAULT_FPS) as video:
            for entry in counted(self._manifest.pictures, path.name, self.count):
                video.add(read_pixels(self._folder / entry.name), entry.time_s)
        if video.encoder:
            notice(f"{path}: {video.encoder.shown}")


def read_pixels(exr: Path) -> np.ndarray:
    """The tone-mapped picture beside an EXR, (height, width, 4) uint8. Raises UserError when it is missing or no such picture."""
    import cv2  # here, since it takes a tenth of a second to load

    path = exr.with_suffix(".png")
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape[2:] != (4,):
        raise UserError(f"{path}: cannot be read back; was it removed or replaced meanwhile?")
    return image[..., [2, 1, 0, 3]]


def write_contact_sheet(path: Path, pictures: list[Path]) -> None:
    """Writes a sheet of thumbnails of the pictures' .png, in rows: all of up to CONTACT_SHEET_PICTURES, else that many, evenly chosen."""
    import cv2

    chosen = [pictures[i] for i in np.unique(np.linspace(0, len(pictures) - 1, CONTACT_SHEET_PICTURES).round().astype(int))]
    thumbnails = []
    for name in chosen:
        image = over_background(read_pixels(name))
        height = max(1, round(image.shape[0] * THUMBNAIL_WIDTH / image.shape[1]))
        thumbnails.append(cv2.resize(image, (THUMBNAIL_WIDTH, height), interpolation=cv2.INTER_AREA))
    height = thumbnails[0].shape[0]
    rows = -(-len(thumbnails) // CONTACT_SHEET_COLUMNS)
    columns = min(len(thumbnails), CONTACT_SHEET_COLUMNS)
    sheet = np.full((rows * height, columns * THUMBNAIL_WIDTH, 3), BACKGROUND, np.uint8)
    for k, thumbnail in enumerate(thumbnails):
        row, column = divmod(k, CONTACT_SHEET_COLUMNS)
        sheet[row * height : (row + 1) * height, column * THUMBNAIL_WIDTH : (column + 1) * THUMBNAIL_WIDTH] = thumbnail
    write_png(path, sheet)
