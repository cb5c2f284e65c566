"""`vemlight archive`: the lights of a long recording, made by several processes, that goes on where it was cut off.

Stage 1 makes maps of chunks in any order; stage 2, in this process, makes lights of them in order and keeps its state behind each chunk.
The lights are those of `vemlight lights` to the byte, whatever the chunks, the workers and the interruptions.
"""

import math
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from vemlight import settings
from vemlight.capture.exposure_recording import ExposureRecording
from vemlight.capture.source import FilesOfFrames, open_files
from vemlight.commands.archive.chunks import ChunkDone, say
from vemlight.commands.archive.folder import LIGHTS, ArchiveFolder, claimed_archive, has_maps
from vemlight.commands.archive.map_file import MapReader
from vemlight.commands.archive.plan import CHUNK_BYTES, ArchivePlan, files_digest, found_plan, new_plan
from vemlight.commands.archive.workers import LocalWorkers
from vemlight.commands.lighting import LightingState, lit_frame
from vemlight.commands.offline import capture_of, limited_to, sampler_settings
from vemlight.commands.options import ArchiveOptions
from vemlight.commands.report import Report
from vemlight.errors import Interrupted, UserError
from vemlight.files import notice, open_regular
from vemlight.runtime.interrupt import interruption
from vemlight.runtime.progress import counted, logged
from vemlight.source_names import is_live, shown_source

if TYPE_CHECKING:
    from vemlight.commands.archive.dask_workers import DaskWorkers

USUAL_WORKERS = 8  # at most, where --workers is left out: more wait for the lights, which one process makes


def archive(options: ArchiveOptions) -> Report:
    """Makes or continues an archive, or only its maps. Raises UserError before any work for what does not fit together."""
    check_options(options)
    capture = limited_to(capture_of(options), options.frames)
    if is_live(capture.source):
        shown = shown_source(capture.source)
        raise UserError(f"{shown}: comes live, once; record it first (vemlight record), and archive the recording")
    source = open_files(capture)
    plan = _plan(options, source, capture)
    if Path(capture.source).is_dir() and options.out.exists() and options.out.samefile(capture.source):
        raise UserError(f"--out {options.out}: is the folder of the recording itself; name another one")
    with ExitStack() as open_:
        dask = open_.enter_context(_dask_workers(options.scheduler)) if options.scheduler else None
        open_.enter_context(claimed_archive(options.out, plan, shared=options.maps_only))
        folder = ArchiveFolder(options.out, plan)
        if folder.is_complete():
            folder.tidy()
            notice(f"{options.out}: is complete; remove the folder to make it again")
            return Report(f"{options.out / LIGHTS}: the lights of {plan.frames} frames", {"out": str(options.out), "frames": plan.frames})
        if options.maps_only:
            return _maps_only(options, folder, source, plan)
        folder.resume(lambda chunk: files_digest(source, plan.frames_of(chunk)))
        return _Archiving(options, folder, source, plan, dask).run()


def check_options(options: ArchiveOptions) -> None:
    """Raises UserError for options that exclude each other."""
    if options.maps_only and options.from_maps:
        raise UserError("--from-maps: makes lights of the maps that --maps-only makes; run one after the other")
    for name, given in (("--workers", options.workers), ("--scheduler", options.scheduler)):
        if given and options.from_maps:
            raise UserError(f"{name}: makes maps, and --from-maps takes those that are there; leave one of them out")
    if options.scheduler and (options.workers or options.maps_only):
        other = "--workers" if options.workers else "--maps-only"
        raise UserError(f"--scheduler: has workers of its own, which send their maps; leave {other} out")
    if not options.maps_only and (options.index is not None or options.indices is not None):
        raise UserError("--index: is for --maps-only, of which several share the chunks; leave it out, or add --maps-only")
    if options.maps_only and not 0 <= (options.index or 0) < (options.indices or 1):
        raise UserError(f"--index {options.index}: is not below --indices {options.indices or 1}; count from 0, and say --indices of all")


def _plan(options: ArchiveOptions, source: FilesOfFrames, capture: settings.Capture) -> ArchivePlan:
    """The plan; chunks as the one that is there has them, unless --chunk says how long they are."""
    sampling = sampler_settings(options, len(source), clusters=options.clusters, error_percent=options.error_percent,
                                soft=options.soft)  # fmt: skip
    first = source.frame(0)  # a source of which no map can be made is refused before anything is written
    found = None if options.chunk else found_plan(options.out)
    usual = max(1, CHUNK_BYTES // first.radiance.nbytes)
    return new_plan(source, capture, sampling, options.chunk or (found.chunk_frames if found else usual))


def _dask_workers(scheduler: str) -> "DaskWorkers":
    from vemlight.commands.archive.dask_workers import DaskWorkers

    return DaskWorkers(scheduler)


def _worker_count(options: ArchiveOptions, source: FilesOfFrames) -> int:
    if isinstance(source, ExposureRecording):
        if (options.workers or 1) > 1:
            notice("--workers: each frame of exposures in turn follows from those before it, so one worker makes the maps")
        return 1
    return options.workers or min(len(os.sched_getaffinity(0)), USUAL_WORKERS)


def _maps_only(options: ArchiveOptions, folder: ArchiveFolder, source: FilesOfFrames, plan: ArchivePlan) -> Report:
    """Makes the maps of chunks index, index + indices, ... that are not there."""
    index, indices = options.index or 0, options.indices or 1
    own = range(index, plan.chunks, indices)
    missing = [k for k in own if not has_maps(folder.maps(k), folder.plan_digest, k, files_digest(source, plan.frames_of(k)))]
    for done in counted(LocalWorkers(folder.path, _worker_count(options, source)).done(missing), "chunks", len(missing)):
        say(done)
        if done.fault:
            raise UserError(done.fault)
    share = f", {index} of {indices}" if indices > 1 else ""
    return Report(f"{options.out}: maps of {len(own)} of {plan.chunks} chunks{share}", {"out": str(options.out), "chunks": len(own)})


class _Archiving:
    """Stage 2, and what it takes from stage 1."""

    def __init__(
        self, options: ArchiveOptions, folder: ArchiveFolder, source: FilesOfFrames, plan: ArchivePlan, dask: "DaskWorkers | None"
    ) -> None:
        """dask: the workers of --scheduler; None: this machine's."""
        self._options, self._folder, self._source, self._plan, self._dask = options, folder, source, plan, dask
        self._sampling = plan.sampler_settings()
        self._maps_s = self._lights_s = 0.0  # processor time
        self._mapped = self._made = 0  # frames by this run: maps, lights

    def run(self) -> Report:
        """Raises UserError for a frame that cannot be read, and Interrupted; the chunks before it stay."""
        missing = self._plan.frames - self._folder.state.chunks * self._plan.chunk_frames
        try:
            for _ in logged(counted(self._frames(), "frames", missing), str(self._options.out), self._plan.frames, missing):
                interruption.check()
        except KeyboardInterrupt as error:
            done = f"{self._folder.state.chunks} of {self._plan.chunks} chunks"
            raise Interrupted(f"{self._options.out} is partial, {done}; the same command goes on from there") from error
        self._folder.complete()
        return self._report()

    def _frames(self) -> Iterator[None]:
        """Yields behind each frame."""
        for chunk, file in self._chunks(range(self._folder.state.chunks, self._plan.chunks)):
            yield from self._light(chunk, file)

    def _chunks(self, chunks: Sequence[int]) -> Iterator[tuple[int, BinaryIO]]:
        """Files of maps, in order."""
        if self._dask:
            for done, maps in self._dask.done(self._plan, chunks):
                yield self._taken(done).chunk, BytesIO(maps)
            return
        there = {k for k in chunks if has_maps(self._folder.maps(k), self._folder.plan_digest, k, self._digest(k))}
        missing = [k for k in chunks if k not in there]
        if self._options.from_maps and missing:
            raise UserError(f"{self._folder.maps(missing[0])}: is missing, or of other frames; run --maps-only first")
        made = LocalWorkers(self._folder.path, _worker_count(self._options, self._source)).done(missing)
        for chunk in chunks:
            if chunk not in there:
                self._taken(next(made))
            with open_regular(self._folder.maps(chunk)) as maps:
                yield chunk, maps

    def _taken(self, done: ChunkDone) -> ChunkDone:
        say(done)
        if done.fault:
            chunks = self._folder.state.chunks
            before = f"{chunks} chunks" if chunks > 1 else "chunk"
            kept = f" ({self._options.out} keeps the {before} before it)" if chunks else ""
            raise UserError(f"{done.fault}{kept}")
        self._maps_s += done.cost_s
        self._mapped += len(self._plan.frames_of(done.chunk))
        return done

    def _check_files(self, chunk: int, digest: str) -> None:
        """Raises UserError for maps of other files than are here: an archive with their lights could not be gone on with."""
        if digest != self._digest(chunk):
            frames = self._plan.frames_of(chunk)
            found = f"the files of frames {frames[0]} to {frames[-1]} have changed while their maps were made, or a worker has others"
            raise UserError(f"{self._options.out}: {found} (sizes or times); give all workers the same, and run the same command again")

    def _digest(self, chunk: int) -> str:
        return files_digest(self._source, self._plan.frames_of(chunk))

    def _light(self, chunk: int, maps: BinaryIO) -> Iterator[None]:
        """Adds the lights of a chunk, yielding behind each frame. Raises UserError for maps that are damaged."""
        began_s, lighting = time.process_time(), self._folder.state.lighting

        def after() -> LightingState:
            return lighting

        try:
            reader = MapReader(maps)
            if reader.header.frames != len(self._plan.frames_of(chunk)):
                raise ValueError("has another number of frames")
            self._check_files(chunk, reader.header.files)
            with self._folder.adding(after, reader.header.files) as file:
                for frame in reader.frames():
                    number = lighting.tally.frames
                    with interruption.deferred():  # raised while numba loads a kernel, Ctrl-C ended the process by a segmentation fault
                        lighting, lit = lit_frame(self._sampling, lighting, frame)
                    file.write(lit.row_json(number))
                    self._made += 1
                    yield
        except UserError:
            raise
        except ValueError as error:
            self._folder.maps(chunk).unlink(missing_ok=True)
            way_out = "make it again by --maps-only" if self._options.from_maps else "the same command makes it again"
            raise UserError(f"{self._folder.maps(chunk)}: {error}, and was removed; {way_out}") from error
        self._lights_s += time.process_time() - began_s

    def _report(self) -> Report:
        tally, limit = self._folder.state.lighting.tally, 100 * self._sampling.error_limit
        tally.say(limit)
        path = self._options.out / LIGHTS
        text = f"{path}: {tally.text(limit)}"
        values = {"out": str(path), "frames": tally.frames, "lights": {"fewest": tally.fewest, "most": tally.most}}
        if self._made and self._mapped:
            maps_ms, lights_ms = 1000 * self._maps_s / self._mapped, 1000 * self._lights_s / self._made
            most = math.ceil(maps_ms / lights_ms)
            text += (
                f"\n{maps_ms:.1f} ms of processor time a frame for maps, {lights_ms:.1f} for lights, which one process makes: "
                f"more than {most} {'worker gains' if most == 1 else 'workers gain'} nothing"
            )
            values |= {"maps_ms": round(maps_ms, 3), "lights_ms": round(lights_ms, 3), "useful_workers": most}
        return Report(text, values)
