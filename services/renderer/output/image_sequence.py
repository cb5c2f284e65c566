"""The pictures of a run as files: frame_0000.exr (linear) and .png (tone-mapped), a manifest, a contact sheet and a video of them."""

import hashlib
from pathlib import Path

import cv2
import msgspec
import numpy as np

from vemlight.errors import UserError
from vemlight.files import decoded_json
from vemlight.light.images import write_exr, write_png
from vemlight.renderer.output.tonemap import Adaptation
from vemlight.renderer.output.video import BACKGROUND, over_background, video_writer
from vemlight.runtime import wire
from vemlight.runtime.progress import counted

CONTACT_SHEET_COLUMNS = 6
CONTACT_SHEET_PICTURES = 24
THUMBNAIL_WIDTH = 320  # pixels; 6 of them make 1920
DEFAULT_FPS = 25.0  # of a video of one picture, whose time steps say no rate


class PictureEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A line of manifest.jsonl: a picture that is whole on the disk.

    sha256: of the EXR. adaptation: the tone mapping's after this picture, from which a renderer that was killed goes on.
    """

    name: str
    sequence: int
    time_s: float
    sha256: str
    adaptation: Adaptation


class ImageSequenceWriter:
    """Writes numbered pictures to a folder, in order. Opening removes a half-written last line of the manifest."""

    def __init__(self, folder: Path) -> None:
        """Raises UserError when the folder cannot be written or its manifest is not one of pictures."""
        self._folder = folder
        path = folder / "manifest.jsonl"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._manifest = open(path, "a+b")  # noqa: SIM115, it stays open as long as its writer
        except OSError as error:
            raise UserError(f"{path}: cannot be written ({error.strerror}); choose another --out") from error
        self._manifest.seek(0)
        lines = self._manifest.read().split(b"\n")
        self._manifest.truncate(sum(len(line) + 1 for line in lines[:-1]))
        try:
            self._entries = [decoded_json(line, PictureEntry) for line in lines[:-1]]
        except ValueError as error:
            raise UserError(f"{path}: is no manifest of pictures ({error}); choose another --out") from error

    @property
    def count(self) -> int:
        return len(self._entries)

    @property
    def last(self) -> PictureEntry | None:
        return self._entries[-1] if self._entries else None

    def add(self, picture: np.ndarray, pixels: np.ndarray, stamp: wire.Stamp, adaptation: Adaptation) -> None:
        """Writes one frame: `picture` (height, width, 4) float32, linear, and `pixels`, the same tone-mapped, uint8.

        Raises OSError when the disk refuses.
        """
        stem = f"frame_{stamp.sequence:04d}"
        exr = self._folder / f"{stem}.exr"
        write_exr(exr, picture, {"imageCounter": stamp.sequence % 2**31, "vemlight:sequence": str(stamp.sequence)})
        write_png(exr.with_suffix(".png"), pixels)
        digest = hashlib.sha256(exr.read_bytes()).hexdigest()
        entry = PictureEntry(exr.name, stamp.sequence, stamp.time_s, digest, adaptation)
        self._manifest.write(msgspec.json.encode(entry) + b"\n")
        self._manifest.flush()
        self._entries.append(entry)

    def write_contact_sheet(self) -> None:
        """Writes contact.png of all pictures. Does nothing when there is none."""
        if self._entries:
            write_contact_sheet(self._folder / "contact.png", [self._folder / entry.name for entry in self._entries])

    def write_video(self, path: Path) -> None:
        """Writes all pictures as a video, read back from their files, so that restarts of the renderer do not show in it."""
        steps_s = np.diff([entry.time_s for entry in self._entries])
        steps_s = steps_s[steps_s > 0]
        with video_writer(path, 1 / float(np.median(steps_s)) if len(steps_s) else DEFAULT_FPS) as add:
            for entry in counted(self._entries, path.name, len(self._entries)):
                add(read_pixels(self._folder / entry.name), entry.time_s)


def read_pixels(exr: Path) -> np.ndarray:
    """The tone-mapped picture beside an EXR, (height, width, 4) uint8. Raises UserError when it is missing or no such picture."""
    path = exr.with_suffix(".png")
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if image is None or image.shape[2:] != (4,):
        raise UserError(f"{path}: cannot be read back; was it removed or replaced meanwhile?")
    return image[..., [2, 1, 0, 3]]


def write_contact_sheet(path: Path, pictures: list[Path]) -> None:
    """Writes a sheet of thumbnails of the pictures' .png, in rows: all of up to CONTACT_SHEET_PICTURES, else that many, evenly chosen."""
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
