"""The lights of a batch on the GPU: the frame of each, which shaders read row by row."""

import moderngl

from vemlight.renderer.gl.buffers import LIGHT_FRAME
from vemlight.renderer.gl.constants import MAX_LIGHTS, WORK_GROUP
from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.shadow_maps.casters import PlacedCasters
from vemlight.renderer.passes.shadow_maps.shadow_map_plan import Batch, LightRow

FRAME_BYTES = LIGHT_FRAME.dtype.itemsize


class LightFrames:
    """A buffer of LIGHT_FRAME, row after row, and what makes it of the lights' entries."""

    def __init__(self, context: moderngl.Context, programs: Programs) -> None:
        self._context = context
        self._program = programs.compute("light_frames.comp")
        self._entries = context.buffer(reserve=64, dynamic=True)
        self._frames = context.buffer(reserve=MAX_LIGHTS * FRAME_BYTES)

    def make(self, batch: Batch, placed: PlacedCasters) -> None:
        """Has the GPU make the frames of all rows from the lights' directions and the box around the casters."""
        for name in ("box_centre", "box_half"):
            self._program[name] = tuple(getattr(placed, name).tolist())
        count = len(batch.entries)
        if self._entries.size < batch.entries.nbytes:
            self._entries.orphan(batch.entries.nbytes)
            self._frames.orphan((count + MAX_LIGHTS) * FRAME_BYTES)  # a uniform block is bound whole, even from the last row on
        self._entries.write(batch.entries.tobytes())
        self._entries.bind_to_storage_buffer(1)
        self._frames.bind_to_storage_buffer(2)
        self._program["light_count"] = count
        self._program.run(group_x=-(-count // WORK_GROUP))
        self._context.memory_barrier()

    def bind_row(self, row: LightRow) -> None:
        """Makes a row of the batch made last the `Lights` of the programs that follow."""
        self._frames.bind_to_uniform_block(0, offset=row.first * FRAME_BYTES, size=MAX_LIGHTS * FRAME_BYTES)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for buffer in (self._entries, self._frames):
            buffer.release()
