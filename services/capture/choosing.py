"""Which source plays: the settings' one, or one that the person at the viewer has chosen. Another is opened while this one goes on."""

from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from pathlib import Path

import msgspec

from vemlight import settings
from vemlight.capture.live_recording import LiveRecording
from vemlight.capture.recent import RecentFrames
from vemlight.capture.sequence import RADIANCE_SUFFIXES, STILL_SUFFIXES
from vemlight.capture.stage import CaptureCamera, CaptureSource
from vemlight.capture.v4l2 import list_cameras
from vemlight.errors import FatalError, UserError
from vemlight.files import notice
from vemlight.light.film_file import FILM_SUFFIXES
from vemlight.runtime import wire
from vemlight.runtime.channels import Instance
from vemlight.runtime.playback import Playback
from vemlight.runtime.session import upload_folder
from vemlight.settings import chosen_capture
from vemlight.source_names import is_live

BUNDLED_CHOICE, RECENT_CHOICE = "bundled", "recent"
LIST_EVERY = 10  # statuses, which is 5 s: cameras come and go, recordings end
MAX_REFUSAL = 512  # letters, as on the wire
MAX_LISTED = 2000  # names of the recordings folder that are looked at, in 10 ms each time
OFFERED = 48  # recordings: of the 64 choices of a message the other 16 are for cameras, the bundled sequence and the last seconds
Playing = CaptureSource | CaptureCamera


class ChosenSources:
    """See `vemlight.runtime.source_loop.Host`."""

    def __init__(self, settings: settings.Settings, service: Instance = "capture") -> None:
        """Raises UserError for a source of the settings that cannot be used."""
        self._settings, self._service = settings, service
        self.current: Playing = self._made(settings.capture)
        self.choice: str | None = None  # None: the settings' source
        self._control = wire.ControlMessage()
        self._refused: tuple[str | None, ...] = ()  # the choice that was refused, until another is made
        self._refusal = ""
        self._opening: tuple[str | None, Future[Playing]] | None = None
        self._opener = ThreadPoolExecutor(1, "opener")
        self._choices: tuple[wire.SourceChoice, ...] = ()
        self._asked = 0
        self._recording = LiveRecording(settings.capture)

    def on_control(self, control: wire.ControlMessage) -> None:
        """Takes what the person has chosen; another source begins to be opened."""
        self._control = control
        self.current.on_control(control)
        self._recording.obey(control.record, self.current)
        if control.source not in self._refused:
            self._refused = ()
        if control.source == self.choice or self._refused:
            return
        if self._opening is None:
            self._refusal = ""
            self._opening = control.source, self._opener.submit(self._opened, control.source)

    def changed(self) -> bool:
        """Whether another source is ready to play."""
        if self._opening is None or not self._opening[1].done():
            return False
        choice, future = self._opening
        error = future.exception()
        if error is None and choice == self._control.source:
            return True
        self._opening = None
        if error is None:  # meanwhile another one was chosen
            future.result().close()
        elif isinstance(error, UserError | FatalError | OSError):
            self._refuse(choice, error)
        else:
            raise error
        return False

    def advance(self) -> None:
        """Goes on to the source that is ready."""
        assert self._opening
        (choice, future), self._opening = self._opening, None
        self._leave()
        self.choice, self.current = choice, future.result()
        self.current.on_control(self._control)

    def fall_back(self, error: UserError) -> None:
        """Goes back to the settings' source from one that cannot play on. Raises the error where it is that one."""
        if self.choice is None:
            raise error
        self._refuse(self.choice, error)
        self._leave()
        self.choice, self.current = None, self._made(self._settings.capture)

    def _leave(self) -> None:
        """Ends the source that plays, and a recording of it."""
        self._recording.leave(self.current)
        self.current.close()

    def _refuse(self, choice: str | None, error: Exception) -> None:
        self._refused, self._refusal = (choice,), shown_refusal(choice, error, self._settings.capture.recordings)

    def on_played(self, playback: Playback) -> None:
        self.current.on_played(playback)

    def about(self) -> wire.Message:
        """What is said of the source and of the others that there are."""
        if self._asked % LIST_EVERY == 0:
            self._choices = self._listed()
        self._asked += 1
        header, arrays = self.current.about()
        recent = self.current.recent if isinstance(self.current, CaptureCamera) else None
        choices, recorded = self._choices, self._recording.said(self.current)
        if (recent and recent.span_s) or self.choice == RECENT_CHOICE:
            choices = (*choices, wire.SourceChoice(choice=RECENT_CHOICE, label="the last seconds of the camera"))
        header = msgspec.structs.replace(
            header,
            choice=self.choice,
            choices=choices[: wire.MAX_CHOICES],
            opening=self._opening[0] if self._opening else None,
            refusal=(self._refusal or self._recording.refusal)[:MAX_REFUSAL],
            recent_s=recent.span_s if recent else 0.0,
            recent_bytes=recent.nbytes if recent else 0,
            **recorded,
        )
        return header, arrays

    def close(self) -> None:
        """Ends what plays and what is recorded."""
        self._leave()
        self._opener.shutdown(wait=False, cancel_futures=True)

    def _made(self, capture: settings.Capture) -> Playing:
        whole = msgspec.structs.replace(self._settings, capture=capture)
        if not is_live(capture.source):
            return CaptureSource(whole, self._service)
        camera = CaptureCamera(capture, self._service)
        camera.recent = RecentFrames()
        return camera

    def _opened(self, choice: str | None) -> Playing:
        """The source of a choice. Raises UserError for one that there is not or that cannot be used."""
        own = self._settings.capture
        if choice is None:
            return self._made(own)
        kind, _, name = choice.partition(" ")
        if choice == RECENT_CHOICE:
            return self._recent()
        if choice == BUNDLED_CHOICE:
            return self._made(chosen_capture(own, ""))
        if kind == "upload" and (folder := upload_folder(name)):
            return self._made(chosen_capture(own, str(played_path(folder))))
        if kind == "recording" and own.recordings and Path(name).name == name and is_playable(Path(own.recordings) / name):
            return self._made(chosen_capture(own, str(Path(own.recordings) / name)))
        if kind == "camera" and name in {Path(camera.path).name for camera in list_cameras()}:
            same_kind = own if is_live(own.source) else chosen_capture(own, "")
            return self._made(msgspec.structs.replace(same_kind, source=f"/dev/{name}", record="", brackets=False))
        raise UserError("it is not there any more; choose another source")

    def _recent(self) -> CaptureSource:
        recent = self.current.recent if isinstance(self.current, CaptureCamera) else None
        if not recent or not recent.span_s:
            raise UserError("no seconds of a camera are kept; choose a camera first")
        whole = msgspec.structs.replace(self._settings, capture=chosen_capture(self._settings.capture, ""))
        return CaptureSource(whole, self._service, recent.frozen(), f"the last {recent.span_s:.0f} s of {self.current.name}")

    def _listed(self) -> tuple[wire.SourceChoice, ...]:
        own = self._settings.capture
        found = [wire.SourceChoice(choice=BUNDLED_CHOICE, label="bundled sequence")]
        for camera in list_cameras():
            name = Path(camera.path).name
            found.append(wire.SourceChoice(choice=f"camera {name}"[:80], label=f"{name}: {camera.card}"[:64]))
        for name in recordings(own.recordings):
            found.append(wire.SourceChoice(choice=f"recording {name}", label=name[:64]))
        return tuple(found[: wire.MAX_CHOICES - 1])


def recordings(folder: str) -> list[str]:
    """The names of what may be played in the recordings folder, in order; none without one. Of more than OFFERED those that were changed
    last; a notice says so.
    """
    if not folder:
        return []
    try:
        entries = list(islice(Path(folder).iterdir(), MAX_LISTED + 1))
        playable = [path for path in entries if is_playable(path)]
        if len(playable) > OFFERED or len(entries) > MAX_LISTED:
            notice(f"[capture] recordings: {folder} holds more than the page offers, the {OFFERED} that were changed last; move some away")
            playable = sorted(playable, key=lambda path: path.stat().st_mtime)[-OFFERED:]
    except OSError:
        return []
    return sorted(path.name for path in playable)


def is_playable(path: Path) -> bool:
    """Whether the page may offer what is at the path: a folder, a film or an image whose name fits a choice."""
    name, suffixes = path.name, (*RADIANCE_SUFFIXES, *STILL_SUFFIXES, *FILM_SUFFIXES)
    can_be_named = bool(name) and not name.startswith(".") and name.isprintable() and len(f"recording {name}") <= 80
    return can_be_named and (path.is_dir() or path.suffix.lower() in suffixes)


def played_path(folder: Path) -> Path:
    """What is played of an upload: its file where there is one alone, else the folder."""
    files = list(folder.iterdir())
    return files[0] if len(files) == 1 else folder


def shown_refusal(choice: str | None, error: Exception, recordings_folder: str = "") -> str:
    """One line for the page: without the folders that files lie in, which are nobody's concern there."""
    kind, _, number = (choice or "").partition(" ")
    text = " ".join(str(error).split()).removeprefix("[capture] source: ")
    folder = upload_folder(number) if kind == "upload" else recordings_folder if kind == "recording" else None
    text = text.replace(f"{folder}/", "").replace(str(folder), "its folder") if folder else text
    return f"{choice or 'the source'}: {text}"[:MAX_REFUSAL]
