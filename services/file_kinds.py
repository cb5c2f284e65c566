"""What a file is by its first bytes, to say so where another kind was expected."""

from pathlib import Path

from vemlight.errors import UserError

BEGINNINGS = (
    (b"\x89PNG\r\n\x1a\n", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"II*\x00", "a TIFF picture"),
    (b"MM\x00*", "a TIFF picture"),
    (b"II+\x00", "a TIFF picture"),
    (b"MM\x00+", "a TIFF picture"),
    (b"\xff\x0a", "a JPEG XL picture"),
    (b"\x00\x00\x00\x0cJXL ", "a JPEG XL picture"),
    (b"\x00\x00\x00\x0cjP  ", "a JPEG 2000 picture"),
    (b"PF\n", "a portable float map"),
    (b"Pf\n", "a portable float map"),
    (b"version https://git-lfs", "a pointer of Git LFS"),
    (b"<!DOCTYPE html", "a web page"),
    (b"<html", "a web page"),
    (b"BM", "a BMP picture"),
    (b"GIF8", "a GIF picture"),
    (b"\x76\x2f\x31\x01", "an OpenEXR picture"),
    (b"#?R", "a Radiance picture"),  # RADIANCE, and RGBE of other writers
    (b"glTF", "a glTF scene"),
    (b"\x1aE\xdf\xa3", "a Matroska video"),
    (b"PK\x03\x04", "a ZIP archive"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"%PDF", "a PDF document"),
    (b"\x7fELF", "a program"),
    (b"\xff\xfe", "text in UTF-16"),
    (b"\xfe\xff", "text in UTF-16"),
)
BRANDS = {  # of files that are built like MP4 (ISO/IEC 14496-12, 23008-12)
    b"avif": "an AVIF picture", b"avis": "an AVIF picture", b"heic": "a HEIC picture", b"heix": "a HEIC picture",
    b"hevc": "a HEIC picture", b"mif1": "a HEIC or AVIF picture", b"msf1": "a HEIC or AVIF picture", b"crx ": "a raw photograph (CR3)",
}  # fmt: skip
STAND_INS = ("a pointer of Git LFS", "a web page")  # which come instead of a file that was not downloaded
BINARY = "a binary file"
BINARY_UNTIL = 4096  # bytes in which a NUL shows that a file is no text


def file_kind(content: bytes) -> str:
    """The kind of a file with that content, with its article; empty when it may be any text."""
    if content[4:8] == b"ftyp":
        return BRANDS.get(content[8:12], "an MP4 video")
    if content[:4] == b"RIFF":
        return {b"WEBP": "a WebP picture", b"AVI ": "an AVI video"}.get(content[8:12], BINARY)
    named = next((name for beginning, name in BEGINNINGS if content.startswith(beginning)), "")
    return named or (BINARY if b"\x00" in content[:BINARY_UNTIL] else "")


def check_kind(path: Path, content: bytes, wanted: str) -> None:
    """Raises UserError for the content of a file that is of another known kind than the one that its suffix says, `wanted`."""
    found = file_kind(content[:BINARY_UNTIL])
    if found in STAND_INS:
        raise UserError(f"{path}: is {found}; download the file itself")
    if found not in ("", BINARY, wanted):
        raise UserError(f"{path}: is {found} and is named {path.suffix}; rename it, or convert it to {wanted}")
