"""The layers of a USD scene, opened only after what they refer to was found to lie in the scene's folder.

USD opens whatever a layer names, anywhere on the machine, while it composes a stage. So each layer is first opened by itself, and every
path that it holds is looked at: sublayers, references, payloads, clips, textures.
"""
# pyright: reportAttributeAccessIssue=false

import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pxr import Ar, Sdf, Tf, Usd, UsdUtils  # pyright: ignore[reportMissingImports]

from vemlight.errors import UserError
from vemlight.files import ADDRESS, MAX_SHOWN, check_regular

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
MAX_BYTES = 2**30  # of all layers and textures, as of a glTF with all that it refers to
MAX_LAYERS = 10_000


class CheckedLayers:
    """The layers that a file needs. stored_bytes: theirs and those of the assets that were read. note: takes lines on what is left out."""

    def __init__(self, path: Path, note: Callable[[str], None]) -> None:
        """Raises UserError for a layer or texture outside the folder of the file, and for packages that unpack to more than they hold."""
        self._folder, self._note = os.path.realpath(path.parent), note
        self._sizes: dict[str, int] = {}
        self._layers: dict[str, Any] = {}  # kept, so that the stage is composed of these
        waiting = [os.path.realpath(path)]
        while waiting:
            identifier = waiting.pop()
            if identifier in self._layers:
                continue
            if len(self._layers) >= MAX_LAYERS:
                raise UserError(f"has more than {MAX_LAYERS} layers; flatten them")
            self._count(identifier)
            try:
                layer = Sdf.Layer.FindOrOpen(identifier)
            except Tf.ErrorException:  # its text is usd-core's own, with the names of its source files
                layer = None
            if layer is None:
                raise UserError(f"{self._shown(identifier)} is no USD layer that can be read; export it again")
            self._layers[identifier] = layer
            waiting += self._named_by(layer)
        self.root = self._layers[os.path.realpath(path)]

    @property
    def stored_bytes(self) -> int:
        return sum(self._sizes.values())

    def stage(self) -> Any:
        """The stage of all layers, with its payloads."""
        return Usd.Stage.Open(self.root, Usd.Stage.LoadAll)

    def read(self, asset: Any) -> bytes | None:
        """The content of an asset that a layer names; None where there is none. Raises UserError for one outside the folder."""
        resolved = asset.resolvedPath
        if not resolved:
            return None
        self._count(self._contained(resolved, asset.path))
        with Ar.GetResolver().OpenAsset(Ar.ResolvedPath(resolved)) as opened:
            return bytes(opened.GetBuffer())

    def _named_by(self, layer: Any) -> list[str]:
        """The identifiers of the layers that a layer names. What is no layer is taken out of it, with a line."""
        composed = set(layer.GetCompositionAssetDependencies())
        found = []

        def look(reference: str) -> str:
            if not reference:
                return reference
            identifier = self._contained(layer.ComputeAbsolutePath(reference), reference)
            if Path(identifier.rstrip("]")).suffix.lower() in USD_SUFFIXES:
                if _exists(identifier):
                    found.append(identifier)
                else:
                    self._note(f"{reference[:MAX_SHOWN]} is left out: there is no such file")
            elif reference in composed:
                self._note(f"{reference[:MAX_SHOWN]} is left out: it is no USD layer")
                return ""
            return reference

        UsdUtils.ModifyAssetPaths(layer, look)
        return found

    def _contained(self, absolute: str, reference: str) -> str:
        """An absolute path, with links followed, that lies in the folder. Raises UserError for another."""
        outer, inner = Ar.SplitPackageRelativePathOuter(absolute)
        shown = f"{reference[:MAX_SHOWN]}"
        if ADDRESS.match(reference) or "`" in reference or ":SDF_FORMAT_ARGS:" in reference:
            raise UserError(f"{shown} is an address or an expression, and none is opened; put the file beside the one that names it")
        real = os.path.realpath(outer)
        if not Path(real).is_relative_to(self._folder) or ".." in Path(inner).parts or os.path.isabs(inner):
            raise UserError(f"{shown} leads out of the folder of the scene's file; put it in that folder, and name it from there")
        return Ar.JoinPackageRelativePath([real, inner]) if inner else real

    def _count(self, identifier: str) -> None:
        """Counts the bytes of a file before it is opened, of a package all that it unpacks to."""
        outer, _ = Ar.SplitPackageRelativePathOuter(identifier)
        outer = outer or identifier
        if outer in self._sizes:
            return
        check_regular(Path(outer), MAX_BYTES)
        if Path(outer).suffix.lower() == ".usdz":
            _check_package(Path(outer))
        self._sizes[outer] = os.path.getsize(outer)
        if self.stored_bytes > MAX_BYTES:
            raise UserError(f"has over {MAX_BYTES} bytes with all that it refers to; make it smaller")

    def _shown(self, identifier: str) -> str:
        return os.path.relpath(identifier, self._folder)[:MAX_SHOWN]


def _exists(identifier: str) -> bool:
    outer, _ = Ar.SplitPackageRelativePathOuter(identifier)
    return os.path.exists(outer or identifier)


def _check_package(path: Path) -> None:
    """Raises UserError for a package that is not as USD has them: its files uncompressed, so that they are no larger than itself."""
    try:
        with zipfile.ZipFile(path) as package:
            entries = package.infolist()
    except (zipfile.BadZipFile, ValueError, EOFError, NotImplementedError, OSError) as error:
        raise UserError(f"{path.name} is no USDZ package; export it again") from error
    if any(entry.compress_type != zipfile.ZIP_STORED or entry.flag_bits & 1 for entry in entries):
        raise UserError(f"{path.name} is compressed or encrypted, which USDZ packages never are; export it again")
    if sum(entry.file_size for entry in entries) > os.path.getsize(path):
        raise UserError(f"{path.name} claims to hold more than its own size; export it again")
