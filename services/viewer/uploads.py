"""What people drop on the page: files that go into the run's folder under numbers of our own, and are decoded in a process with limits
before anything plays them.
"""

import asyncio
import re
import secrets
import shutil
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from vemlight.errors import UserError, printable_line
from vemlight.file_kinds import BINARY_UNTIL, file_kind
from vemlight.runtime.children import plain_environment
from vemlight.runtime.session import INCOMING, READY, session_folder

MAX_FILES = 1000  # of an upload: a folder of frames; half a minute at 25 a second
MAX_UPLOADS = 32  # that are there at once
MAX_TEXT = 2**20  # bytes of a lens file, a response or a manifest
ABANDONED_S = 120.0  # without a byte, after which an upload that is not complete gives way; 30 to 600 s would do
CHECK_S = 120.0  # for a child to decode: five times what 8192 x 4096 pixels take on a loaded machine
BLOCK = 2**20  # bytes that are written at once
Kind = Literal["light", "scene"]
SUFFIXES: dict[Kind, dict[str, str]] = {  # by what the bytes are, whatever the name says
    "light": {
        "a Radiance picture": ".hdr", "an OpenEXR picture": ".exr", "a PNG picture": ".png", "a JPEG picture": ".jpg",
        "a TIFF picture": ".tif", "an MP4 video": ".mp4", "a Matroska video": ".mkv",
    },
    "scene": {"a glTF scene": ".glb"},
}  # fmt: skip
CHECKS: dict[Kind, str] = {"light": "vemlight.capture.upload_check", "scene": "vemlight.renderer.scene.upload_check"}
TAKEN = {"light": "an .hdr, .exr, .png, .jpg, .tif, .mp4 or .mkv, or a folder of them", "scene": "a .glb"}
BESIDE = ("lens.toml", "response.toml", "manifest.jsonl")  # texts that belong to a folder of frames
PLAIN = re.compile(r"[A-Za-z0-9_-]{1,64}", re.ASCII)  # names that may be kept: a manifest refers to them
OWN = re.compile(r"file_[0-9]{6}", re.ASCII)  # what a name becomes that may not be kept, so nobody else's
NO_SESSION = "nothing is taken here: the viewer was not started by `vemlight run`, which has the folder for it"


class NamedFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A file that is going to be sent. name: the last part of what it was called."""

    name: Annotated[str, Meta(min_length=1, max_length=255)]
    size: Annotated[int, Meta(ge=0, le=2**40)]


class Announcement(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An upload before its first byte."""

    kind: Kind
    label: Annotated[str, Meta(min_length=1, max_length=255)]
    files: Annotated[tuple[NamedFile, ...], Meta(min_length=1, max_length=MAX_FILES)]


class Upload:
    """One of them. missing: the numbers of the files that have not come."""

    def __init__(self, announced: Announcement, folder: Path) -> None:
        self.announced, self.folder = announced, folder
        self.missing = set(range(len(announced.files)))
        self.moved_s = time.monotonic()
        self.is_ready = self.is_checking = False
        self.facts = ""
        self.nbytes = sum(file.size for file in announced.files)
        self.label = printable_line(announced.label)[:64]


class Uploads:
    """All of this run, within the limits of the settings."""

    def __init__(self, max_mb: int) -> None:
        self._max_bytes, self._uploads = max_mb * 1_000_000, dict[str, Upload]()
        self._checking = asyncio.Lock()  # one child at a time: each may take much memory

    def remove_left_over(self) -> None:
        """Deletes what a viewer of this run left that was killed: nobody offers it, or counts its bytes, any more."""
        session = session_folder()
        for folder in (session / INCOMING, session / READY) if session else ():
            for left in folder.iterdir() if folder.is_dir() else ():
                if left.name not in self._uploads:
                    shutil.rmtree(left, ignore_errors=True)

    def summary(self) -> dict[str, Any]:
        """For the page."""
        ready = [
            {"id": number, "kind": upload.announced.kind, "label": upload.label, "facts": upload.facts, "bytes": upload.nbytes}
            for number, upload in self._uploads.items() if upload.is_ready
        ]  # fmt: skip
        return {"uploads": ready, "used_bytes": self._used(), "max_bytes": self._max_bytes}

    def _used(self) -> int:
        return sum(upload.nbytes for upload in self._uploads.values())

    def announce(self, announced: Announcement) -> str:
        """Makes room for an upload; its number. Raises UserError for one that is over a limit."""
        session = session_folder()
        if not self._max_bytes:
            raise UserError("nothing is taken here: [viewer] uploads_mb is 0; give it a number of MB")
        if session is None:
            raise UserError(NO_SESSION)
        old_s = time.monotonic() - ABANDONED_S
        coming = {number: each for number, each in self._uploads.items() if not (each.is_ready or each.is_checking)}
        for number in [number for number, each in coming.items() if each.moved_s < old_s]:
            self.remove(number)
        wanted = sum(file.size for file in announced.files)
        if wanted > (left := self._max_bytes - self._used()):
            room = f"{left / 1e6:.0f} of {self._max_bytes / 1e6:.0f} MB are left for files"
            raise UserError(f"{wanted / 1e6:.1f} MB are too much: {room}; remove others, or raise [viewer] uploads_mb")
        if shutil.disk_usage(session).free < 2 * wanted:
            raise UserError("the disk of the run's folder has too little room for it; remove uploads, or free some")
        if len(self._uploads) >= MAX_UPLOADS:
            raise UserError(f"there are {MAX_UPLOADS} uploads already; remove some")
        if announced.kind == "scene" and len(announced.files) > 1:
            raise UserError("a scene is one file; export it as a .glb with everything in it")
        number = secrets.token_hex(8)
        folder = session / INCOMING / number
        folder.mkdir(mode=0o700)
        self._uploads[number] = Upload(announced, folder)
        return number

    def expected(self, number: str, index: int) -> int:
        """How many bytes file `index` of an upload has. Raises UserError for one that is not expected."""
        upload = self._uploads.get(number)
        if upload is None or index not in upload.missing or upload.is_checking:
            raise UserError("no such file is expected; begin the upload again")
        return upload.announced.files[index].size

    async def receive(self, number: str, index: int, content: AsyncIterator[bytes]) -> None:
        """Writes a file. Raises UserError for content that is longer or shorter than was announced, or of no kind that is taken, and
        removes the whole upload.
        """
        size, upload = self.expected(number, index), self._uploads[number]
        part, received = upload.folder / f"{index}.part", 0
        upload.missing.discard(index)
        try:
            with open(part, "xb") as file:
                async for block in content:
                    received += len(block)
                    if received > size:
                        raise UserError("more bytes came than were announced; announce it anew")
                    upload.moved_s = time.monotonic()
                    await asyncio.to_thread(file.write, block)
            if received < size:
                raise UserError(f"{received} of {size} bytes came")
            part.rename(upload.folder / await asyncio.to_thread(stored_name, part, upload.announced, index))
        except BaseException as error:
            self.remove(number)
            if isinstance(error, OSError):
                raise UserError(f"the file cannot be stored ({error.strerror}); try again") from error
            raise

    async def check(self, number: str) -> str:
        """Decodes an upload in a child and makes it ready; what it is. Raises UserError for one that is not complete or cannot be used,
        which is then removed.
        """
        upload = self._uploads.get(number)
        if upload is None or upload.missing or upload.is_checking or upload.is_ready:
            raise UserError("no such upload is complete; begin it again")
        upload.is_checking = True
        try:
            async with self._checking:
                upload.facts = await decoded(CHECKS[upload.announced.kind], upload.folder)
            if self._uploads.get(number) is not upload:
                raise UserError("it was removed meanwhile")
            upload.folder = upload.folder.rename(upload.folder.parents[1] / READY / number)
            upload.is_ready = True
        except BaseException as error:
            self.remove(number)
            if isinstance(error, OSError):
                raise UserError(f"it cannot be decoded now ({error.strerror}); try again") from error
            raise
        finally:
            upload.is_checking = False
        return upload.facts

    def remove(self, number: str) -> None:
        """Deletes an upload; nothing where there is none."""
        if upload := self._uploads.pop(number, None):
            shutil.rmtree(upload.folder, ignore_errors=True)


def stored_name(part: Path, announced: Announcement, index: int) -> str:
    """Under which name a file is stored: its suffix by its bytes; its stem where that is plain and nobody else's, else its number.

    Raises UserError for a kind that is not taken.
    """
    name = announced.files[index].name
    if announced.kind == "light" and name in BESIDE and len(announced.files) > 1:
        if announced.files[index].size > MAX_TEXT:
            raise UserError(f"{name}: has more than {MAX_TEXT} bytes; shorten it")
        return name
    with open(part, "rb") as file:
        found = file_kind(file.read(BINARY_UNTIL))
    shown = printable_line(name)[:64]
    if found not in SUFFIXES[announced.kind]:
        raise UserError(f"{shown}: is {found or 'no file of a known kind'}; {TAKEN[announced.kind]} is taken here")
    stem, stems = Path(name).stem, [Path(file.name).stem for file in announced.files]
    is_plain = PLAIN.fullmatch(stem) and stems.count(stem) == 1 and not OWN.fullmatch(stem)
    return (stem if is_plain else f"file_{index:06d}") + SUFFIXES[announced.kind][found]


async def decoded(module: str, folder: Path) -> str:
    """What a child says that decodes the files of a folder. Raises UserError with its line when it refuses, ends or takes too long."""
    child = await asyncio.create_subprocess_exec(
        sys.executable, "-P", "-m", module, str(folder), env=plain_environment(),
        stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL,
    )  # fmt: skip
    try:
        async with asyncio.timeout(CHECK_S):
            assert child.stdout
            said = await child.stdout.read(4096)
            status = await child.wait()
    except TimeoutError as error:
        raise UserError(f"it takes over {CHECK_S:.0f} s to decode; use a smaller one") from error
    finally:
        if child.returncode is None:
            child.kill()
            await child.wait()
    text = printable_line(said.decode(errors="replace").strip()).replace(f"{folder}/", "").replace(str(folder), "it")[:400]
    if status == 0 and text:
        return text
    raise UserError(text if status == 2 and text else "it could not be decoded within the limits of memory and time; use a smaller one")
