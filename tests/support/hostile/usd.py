"""USD scenes, which usd-core reads in a process of its own; none where it is not installed."""
# pyright: reportAttributeAccessIssue=false

import importlib.util
import io
import zipfile
from pathlib import Path

from tests.support.hostile.format import Format
from tests.support.hostile.images import png
from tests.support.hostile.meshes import REFERENCES, read_mesh

SHARE = 0.05  # half a second each, where other formats take 10 ms
TRIANGLE = b"int[] faceVertexCounts = [3]\nint[] faceVertexIndices = [0, 1, 2]\npoint3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]\n"
SCENE = b'#usda 1.0\n(\n    upAxis = "Y"\n%s)\n%s\n'
PAINTED = b"""def Material "m" {
    token outputs:surface.connect = </m/s.outputs:surface>
    def Shader "s" {
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor.connect = </m/t.outputs:rgb>
        token outputs:surface
    }
    def Shader "t" {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @%s@
        float3 outputs:rgb
    }
}
def Mesh "a" (prepend apiSchemas = ["MaterialBindingAPI"]) {
    rel material:binding = </m>
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1)] (interpolation = "vertex")
"""


def _painted(file: bytes) -> bytes:
    return SCENE % (b"", PAINTED % file + TRIANGLE + b"}")


def _mesh(text: bytes = TRIANGLE) -> bytes:
    return b'def Mesh "a" {\n' + text + b"}\n"


def _usd_files(folder: Path) -> list[Path]:
    from pxr import Sdf  # pyright: ignore[reportMissingImports]

    (folder / "file.png").write_bytes(png(64, 64))
    (folder / "text.usd").write_bytes(_painted(b"file.png"))
    Sdf.Layer.FindOrOpen(str(folder / "text.usd")).Export(str(folder / "crate.usdc"))
    return [folder / "text.usd", folder / "crate.usdc"]


def _usd_bombs() -> dict[str, bytes]:
    names = [name.encode() for name in (*REFERENCES, "pipe:x", "", ".", "file.usd[a.usda]", "`${X}`", "x" * 5000)]
    bombs = {f"texture {name.decode()[:40]}": _painted(name) for name in names}
    bombs |= {f"sublayer {name.decode()[:40]}": SCENE % (b"subLayers = [@%s@]\n" % name, _mesh()) for name in names}
    bombs |= {f"reference {name.decode()[:40]}": SCENE % (b"", b'def "a" (references = @%s@) {}' % name) for name in names}
    bombs["a layer of itself"] = SCENE % (b"subLayers = [@./file.usd@]\n", _mesh())
    bombs["a reference to itself"] = SCENE % (b"", b'def "a" (references = </a>) {}')
    bombs["20,000 meshes"] = SCENE % (b"", b"".join(b'def Mesh "a%d" {\n%s}\n' % (k, TRIANGLE) for k in range(20_000)))
    bombs["doubling instances"] = SCENE % (
        b"",
        _mesh() + b"".join(b'def "p%d" {\ndef "x" (references = </p%d>) {}\ndef "y" (references = </p%d>) {}\n}\n' % (k, k - 1, k - 1)
                           for k in range(1, 40)) + b'def Xform "p0" {\n' + _mesh() + b"}\n",
    )  # fmt: skip
    bombs["depth"] = SCENE % (b"", b'def "a" {' * 20_000 + b"}" * 20_000)
    counts = (b"-1", b"2147483647", b"1000000000, 1000000000")
    bombs |= {f"faces of {count.decode()}": SCENE % (b"", _mesh(TRIANGLE.replace(b"[3]", b"[%s]" % count))) for count in counts}
    bombs |= {f"index {index}": SCENE % (b"", _mesh(TRIANGLE.replace(b"1, 2]", b"1, %d]" % index))) for index in (3, -1, 2**31 - 1, 2**40)}
    bombs["nan"] = SCENE % (b"", _mesh(TRIANGLE.replace(b"(1, 0, 0)", b"(nan, inf, 0)")))
    many = b'def PointInstancer "p" {\nint[] protoIndices = [%s]\npoint3f[] positions = [%s]\nrel prototypes = </p/a>\n%s}\n'
    bombs["60,000 instances"] = SCENE % (b"", many % (b", ".join([b"0"] * 60_000), b", ".join([b"(0, 0, 0)"] * 60_000), _mesh()))
    bombs["instances of nothing"] = SCENE % (b"", many % (b"7, -1", b"(0, 0, 0)", _mesh()))
    bombs["10^6 lines"] = b"#usda 1.0\n" + b"\n" * 10**6
    bombs["no end"], bombs["empty"], bombs["NUL"], bombs["crate"] = b"#usda 1.0\ndef", b"", bytes(10**6), b"PXR-USDC" + bytes(100)
    return bombs


def _package(content: bytes, name: str = "a.usda", stored: bool = True) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED) as package:
        package.writestr(name, content)
        package.writestr("file.png", png(64, 64))
    return out.getvalue()


def _usdz_files(folder: Path) -> list[Path]:
    (folder / "a.usdz").write_bytes(_package(_painted(b"file.png")))
    return [folder / "a.usdz"]


def _usdz_bombs() -> dict[str, bytes]:
    bombs = {f"in a package, {name}": _package(content) for name, content in _usd_bombs().items() if len(content) < 10**5}
    bombs["packed zeros"] = _package(bytes(10**8), stored=False)
    bombs["a name that leads out"] = _package(_painted(b"file.png"), "../a.usda")
    bombs["no scene"] = _package(b"text", "a.txt")
    bombs["a package in itself"] = _package(_package(_painted(b"file.png")), "a.usdz")
    return bombs


INSTALLED = importlib.util.find_spec("pxr") is not None
FORMATS: dict[str, Format] = {
    "usd": Format(".usd", _usd_files, read_mesh, _usd_bombs, share=SHARE),
    "usdz": Format(".usdz", _usdz_files, read_mesh, _usdz_bombs, share=SHARE),
} if INSTALLED else {}
