"""Frames that a camera sends as JPEG files, decoded one by one."""

from typing import Any

from vemlight.capture.planes import Planes, planes_from_video_frame
from vemlight.errors import UserError


class JpegDecoder:
    """FFmpeg's decoder, which also reads the files without tables that some cameras send."""

    def __init__(self) -> None:
        import av

        self._codec: Any = av.CodecContext.create("mjpeg", "r")

    def planes(self, name: str, data: bytes, width: int, height: int) -> Planes | None:
        """The planes of one picture, None for a damaged one. Raises UserError, with the camera's `name`, for another size."""
        import av.error

        try:
            frames = self._codec.decode(av.Packet(data))
        except av.error.FFmpegError:
            return None
        if not frames or frames[0].is_corrupt:
            return None
        frame = frames[0]
        if (frame.width, frame.height) != (width, height):
            size = f"{frame.width}x{frame.height}"
            raise UserError(f"{name}: sent a picture of {size} and had agreed to {width}x{height}; set [capture] width and height")
        return planes_from_video_frame(name, frame)
