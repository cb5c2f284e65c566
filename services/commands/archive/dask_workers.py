"""The workers of a Dask scheduler, which make maps of chunks and send them; the package is optional (`vemlight[dask]`)."""

import contextlib
import logging
import threading
from collections import deque
from collections.abc import Iterator, Sequence
from io import BytesIO
from types import TracebackType
from typing import Any

import msgspec

from vemlight.commands.archive.chunks import ChunkDone, ChunkMaker
from vemlight.commands.archive.plan import ArchivePlan, plan_json
from vemlight.errors import FatalError, UserError
from vemlight.files import one_line
from vemlight.runtime.interrupt import interruption

CONNECT_S = 10.0  # to the scheduler; any value in 3..60 does
WORKERS_S = 30.0  # until it has one
MAX_THREADS = 8  # that get chunks: more would wait for the lights, which one process makes, and hold maps meanwhile
POLL_S = 0.5  # in which Ctrl-C that a library has swallowed is seen

_of_thread = threading.local()  # a worker's threads share no source


def made_maps(plan: bytes, chunk: int) -> tuple[bytes, bytes]:
    """On a worker: a ChunkDone in JSON, and the file of a chunk's maps. plan: as `plan.json`; its paths are the worker's, too."""
    if getattr(_of_thread, "plan", None) != plan:
        _of_thread.plan, _of_thread.maker = plan, ChunkMaker(msgspec.json.decode(plan, type=ArchivePlan))
    file = BytesIO()
    done = _of_thread.maker.to(chunk, file)
    return msgspec.json.encode(done), b"" if done.fault else file.getvalue()


class DaskWorkers:
    """A connection to a scheduler, until the end of the context."""

    def __init__(self, address: str) -> None:
        """Raises UserError without Dask, and for a scheduler that does not answer or has no workers."""
        try:
            import distributed  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise UserError("--scheduler: Dask is not installed; pip install 'vemlight[dask]'") from error
        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what is wrong is said here
        self._address = address
        try:
            self._client: Any = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, TimeoutError, ValueError) as error:
            raise UserError(f"--scheduler {address}: does not answer ({one_line(error)}); is it running?") from error
        try:
            self._client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError as error:
            self._client.close()
            raise UserError(f"--scheduler {address}: has no workers; start some: dask worker {address}") from error

    def __enter__(self) -> "DaskWorkers":
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._client.close()

    def done(self, plan: ArchivePlan, chunks: Sequence[int]) -> Iterator[tuple[ChunkDone, bytes]]:
        """What became of each chunk of a plan, in order, and its maps; at most twice the threads and one more are on their way.

        Raises FatalError when workers keep dying, or a worker fails by a fault of ours or of its installation.
        """
        import distributed  # pyright: ignore[reportMissingImports]

        threads = sum(worker["nthreads"] for worker in self._client.scheduler_info(n_workers=-1)["workers"].values())
        window = 2 * min(max(threads, 1), MAX_THREADS) + 1
        waiting, running, as_json = deque(chunks), deque[Any](), plan_json(plan)
        while waiting or running:
            while waiting and len(running) < window:
                running.append(self._client.submit(made_maps, as_json, waiting.popleft(), pure=False, retries=0))
            try:
                said, maps = self._result(running.popleft(), distributed.TimeoutError)
            except (KeyboardInterrupt, UserError):
                raise
            except Exception as error:
                raise FatalError(f"--scheduler {self._address}: {one_line(error)}; the same command goes on there") from error
            yield msgspec.json.decode(said, type=ChunkDone), maps

    def _result(self, future: Any, late: type[BaseException]) -> tuple[bytes, bytes]:
        while not future.done():
            interruption.check()
            with contextlib.suppress(late, TimeoutError):
                return future.result(timeout=POLL_S)
            if self._client.status != "running":
                raise OSError("the scheduler is gone")
        return future.result()
