"""Buffers that a camera's driver fills, in one piece or with planes of their own, mapped into our memory."""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

BUFFERS = 4  # frames that the kernel keeps while we are busy, 160 ms at 25 a second; further ones are lost and counted; 2 to 32 do
MAX_PLANES = 8  # of a frame (VIDEO_MAX_PLANES)


class FilledBuffer(NamedTuple):
    """A frame in the kernel's memory. planes: one memoryview, or one a plane; empty where the driver calls it damaged."""

    planes: tuple[memoryview, ...]
    sequence: int
    monotonic_ns: int


class FrameBuffers:
    """The mapped buffers of an open camera. is_multiplanar: its planes have buffers of their own, so many as `planes`."""

    def __init__(self, device: int, is_multiplanar: bool, planes: int) -> None:
        """Asks for buffers, maps them and hands them to the driver. Raises OSError when it has none."""
        from linuxpy.video import device as v4l2

        self._device, self._planes, self._is_multiplanar = device, planes, is_multiplanar
        self._kind = v4l2.BufferType.VIDEO_CAPTURE_MPLANE if is_multiplanar else v4l2.BufferType.VIDEO_CAPTURE
        self._maps: list[list[Any]] = []
        granted = v4l2.request_buffers(device, self._kind, v4l2.Memory.MMAP, BUFFERS).count  # a driver may grant fewer, or more
        for index in range(granted):
            self._map(index)

    def _map(self, index: int) -> None:
        from linuxpy.video import device as v4l2

        if not self._is_multiplanar:
            buffer = v4l2.query_buffer(self._device, self._kind, v4l2.Memory.MMAP, index)
            self._maps.append([v4l2.mmap_from_buffer(self._device, buffer)])
        else:
            buffer = self._described(index)
            v4l2.ioctl(self._device, v4l2.IOC.QUERYBUF, buffer)
            self._maps.append([v4l2.mem_map(self._device, plane.length, plane.m.mem_offset) for plane in self._planes_of(buffer)])
        v4l2.enqueue_buffer_raw(self._device, buffer)

    def _described(self, index: int) -> Any:
        """The structure of a multi-planar buffer, with room for its planes."""
        from linuxpy.video import device as v4l2

        buffer = v4l2.raw.v4l2_buffer()
        buffer.type, buffer.memory, buffer.index, buffer.length = self._kind, v4l2.Memory.MMAP, index, MAX_PLANES
        self._room = (v4l2.raw.v4l2_plane * MAX_PLANES)()
        buffer.m.planes = ctypes.cast(self._room, ctypes.POINTER(v4l2.raw.v4l2_plane))
        return buffer

    def _planes_of(self, buffer: Any) -> list[Any]:
        return [buffer.m.planes[n] for n in range(self._planes)]

    @contextmanager
    def filled(self) -> Iterator[FilledBuffer]:
        """The next frame, which the driver has back afterwards. Raises OSError when there is none, or no camera."""
        from linuxpy.video import device as v4l2

        if self._is_multiplanar:
            buffer = self._described(0)
            v4l2.ioctl(self._device, v4l2.IOC.DQBUF, buffer)
            used = [(plane.data_offset, plane.bytesused) for plane in self._planes_of(buffer)]
        else:
            buffer = v4l2.dequeue_buffer(self._device, self._kind, v4l2.Memory.MMAP)
            used = [(0, buffer.bytesused)]
        damaged = v4l2.BufferFlag.ERROR in v4l2.BufferFlag(buffer.flags)
        views = [memoryview(mapped) for mapped in ([] if damaged else self._maps[buffer.index])]
        planes = tuple(view[begin:end] for view, (begin, end) in zip(views, used, strict=False))
        try:
            yield FilledBuffer(planes, int(buffer.sequence), buffer.timestamp.secs * 10**9 + buffer.timestamp.usecs * 1000)
        finally:
            for view in (*planes, *views):
                view.release()
            v4l2.enqueue_buffer_raw(self._device, buffer)

    def stream(self) -> None:
        """Lets the driver begin."""
        from linuxpy.video import device as v4l2

        v4l2.stream_on(self._device, self._kind)

    def close(self) -> None:
        """Gives the memory back."""
        for maps in self._maps:
            for mapped in maps:
                mapped.close()
        self._maps = []
