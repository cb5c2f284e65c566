"""What hostile peers attack: services with the real loops around made-up frames, so that they start at once."""

import sys
from pathlib import Path

from tests.support.viewer_process import frames_of
from vemlight.runtime import wire
from vemlight.runtime.channels import Service
from vemlight.runtime.loop import run_stage
from vemlight.runtime.source_loop import run_source
from vemlight.runtime.start import start
from vemlight.settings import Settings


class MadeUpSource:
    """Maps at 25 a second, without end."""

    service: Service = "capture"
    fps = 25.0
    limit: int | None = None

    def __len__(self) -> int:
        return 1000

    def message(self, sequence: int, index: int, time_s: float) -> wire.Message:
        header, arrays = frames_of(sequence)["capture"]
        return header, arrays

    def on_control(self, control: wire.ControlMessage) -> None:
        pass


class MadeUpSampler:
    """A light for each map."""

    service: Service = "sampler"

    def side_inputs(self, state: None) -> tuple[str, ...]:
        return ()

    def first_missing_frame(self) -> int:
        return 0

    def start_at(self, target: int) -> tuple[None, int]:
        return None, target

    def step(self, state: None, message: wire.Message) -> tuple[None, wire.Message]:
        assert isinstance(message[0], wire.FrameHeader)
        header, arrays = frames_of(message[0].stamp.sequence)["sampler"]
        return None, (header, arrays)

    def on_message(self, state: None, message: wire.Message) -> None:
        """Ignores it."""

    def write(self, state: None, message: wire.Message) -> None:
        """Writes nothing."""

    def finish(self) -> None:
        """Does nothing."""


def serve(settings: Settings, _: int) -> None:
    if Path(sys.argv[0]).stem != "targets":
        raise SystemExit("python -m tests.support.hostile_peers.targets SETTINGS capture|sampler")
    if sys.argv[2] == "capture":
        run_source(settings, MadeUpSource())
    else:
        run_stage(settings, MadeUpSampler())


if __name__ == "__main__":
    sys.exit(start(serve, sys.argv[1:2]))
