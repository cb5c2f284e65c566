"""A GenICam camera without a device: features with access modes, selectors and locks, and buffers as a producer gives them."""

import struct
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np

from vemlight.capture.genicam_producers import Connection

NA, RO, RW = 1, 3, 4


class Fault(Exception):
    """Stands for what GenApi and producers raise."""


class Feature:
    """A node. locked: whether it cannot be set now; stubborn: it keeps its value."""

    def __init__(
        self, value: Any, least: float = 0, most: float | Callable[[], float] = 1e9, entries: tuple[str, ...] = (), mode: int = RW,
        locked: Callable[[], bool] = lambda: False, stubborn: bool = False, cell: Callable[[], dict[str, Any]] | None = None,
    ) -> None:  # fmt: skip
        self._own, self.min, self._most, self.mode, self.locked, self.stubborn = {"": value}, least, most, mode, locked, stubborn
        self._cell = cell or (lambda: self._own)
        self._key = "" if cell is None else "value"
        self.entries = [SimpleNamespace(symbolic=entry, get_access_mode=lambda: RO) for entry in entries]
        self.symbolics, self.log = entries, []

    def get_access_mode(self) -> int:
        return RO if self.mode == RW and self.locked() else self.mode

    @property
    def max(self) -> float:
        return self._most() if callable(self._most) else self._most

    @property
    def value(self) -> Any:
        if self.mode == NA:
            raise Fault("not available")
        return self._cell()[self._key]

    @value.setter
    def value(self, value: Any) -> None:
        known = not self.symbolics or value in self.symbolics
        in_range = isinstance(value, str | bool) or self.min <= value <= self.max
        if self.get_access_mode() != RW or type(value) is not type(self.value) or not known or not in_range:
            raise Fault("refused")
        self.log.append(value)
        if not self.stubborn:
            self._cell()[self._key] = value

    def get_value(self, verify: bool, ignore_cache: bool) -> Any:
        return self.value


class Nodes:
    """A node map: one that has no such feature raises AttributeError, as GenApi's does."""

    def values(self) -> dict[str, Any]:
        return {name: node.value for name, node in vars(self).items() if isinstance(node, Feature) and node.mode != NA}


def camera_nodes(formats: tuple[str, ...] = ("Mono8", "Mono12"), width: int = 8, height: int = 4) -> Any:
    """A camera whose exposure, gain and white balance go by themselves, and which can send chunks."""
    nodes: Any = Nodes()
    enabled = {chunk: {"value": False} for chunk in ("Image", "ExposureTime", "Timestamp")}
    nodes.ExposureAuto = Feature("Continuous", entries=("Off", "Once", "Continuous"))
    nodes.ExposureTime = Feature(250.0, 10, 1e6, locked=lambda: nodes.ExposureAuto.value != "Off")
    nodes.GainAuto = Feature("Continuous", entries=("Off", "Continuous"))
    nodes.Gain = Feature(3.0, 0, 24, locked=lambda: nodes.GainAuto.value != "Off")
    nodes.BalanceWhiteAuto = Feature("Continuous", entries=("Off", "Continuous"))
    nodes.GammaEnable = Feature(True)
    nodes.Gamma = Feature(0.45, 0.1, 4, locked=lambda: not nodes.GammaEnable.value)
    nodes.PixelFormat = Feature(formats[0], entries=formats)
    nodes.Width, nodes.Height = Feature(width, 2, 4096), Feature(height, 2, 4096)
    nodes.AcquisitionFrameRateEnable = Feature(False)
    nodes.AcquisitionFrameRate = Feature(30.0, 1, 60)
    nodes.ChunkModeActive = Feature(False)
    nodes.ChunkSelector = Feature("Image", entries=tuple(enabled))
    nodes.ChunkEnable = Feature(False, cell=lambda: enabled[nodes.ChunkSelector.value])
    nodes.ChunkExposureTime, nodes.ChunkTimestamp = Feature(0.0, mode=NA), Feature(0, mode=NA)
    nodes.GevTimestampTickFrequency = Feature(125_000_000, mode=RO)
    return nodes


class Device:
    """A producer's camera: `frames` are sent one after the other. One is (codes, number, exposure in us, ticks), None (a silence), an
    error, or "incomplete".
    """

    def __init__(self, nodes: Any, frames: list[Any], encode: Callable[[np.ndarray], bytes] = lambda codes: codes.tobytes()) -> None:
        self.nodes, self.frames, self.encode, self.is_there, self.streams, self.queued = nodes, list(frames), encode, True, False, 0
        self.info: dict[str, Any] = {"padding_x": 0, "pixel_endianness": 1}
        self.remote_device, self.on_incomplete = SimpleNamespace(node_map=nodes), lambda: None

    def connect(self, source: str, wanted: str) -> Connection:
        self.found_by = wanted
        if not self.is_there:
            raise Fault("gone")
        return Connection(SimpleNamespace(reset=self.stop), self, "ID 1", "Maker Model")

    def start(self) -> None:
        self.streams = True

    def stop(self) -> None:
        self.streams = False

    def try_fetch(self, timeout: float, is_raw: bool) -> Any:
        frame = self.frames.pop(0) if self.frames else None
        if isinstance(frame, Exception):
            self.is_there = False
            raise frame
        if frame == "incomplete":
            self.on_incomplete()
        if frame is None or frame == "incomplete":
            return None
        codes, number, exposure_us, ticks = frame
        for name, value in (("ChunkExposureTime", exposure_us), ("ChunkTimestamp", ticks)):
            node = getattr(self.nodes, name)
            node.mode = NA if value is None or not self.nodes.ChunkModeActive.value else RO
            node._own[""] = value
        height, width = codes.shape[:2]
        stream = SimpleNamespace(queue_buffer=self._take_back, parent=SimpleNamespace(timestamp_frequency=None))
        told = {"timestamp_ns": None, "timestamp": None, "image_offset": 0, **self.info}
        return SimpleNamespace(
            raw_buffer=self.encode(codes) + bytes(64), width=width, height=height, frame_id=number, payload_type=1, parent=stream, **told
        )

    def _take_back(self, buffer: Any) -> None:
        self.queued += 1


def packed_lsb(codes: np.ndarray, bits: int) -> bytes:
    """PFNC's p formats: one number of all bits, the first code lowest."""
    whole = sum(int(code) << bits * place for place, code in enumerate(codes.ravel()))
    return whole.to_bytes(-(-codes.size * bits // 8), "little")


def packed_gige(codes: np.ndarray, bits: int) -> bytes:
    """GigE Vision's packed formats: high byte, low bits of both, high byte."""
    flat, low = [int(code) for code in codes.ravel()], 2 ** (bits - 8) - 1
    flat += [0] * (len(flat) % 2)
    pairs = zip(flat[::2], flat[1::2], strict=True)
    whole = b"".join(bytes([a >> bits - 8, (a & low) | (b & low) << 4, b >> bits - 8]) for a, b in pairs)
    return whole[: -(-codes.size * 12 // 8)]


def gige_chunks(image: bytes, exposure_us: float) -> bytes:
    """An image with a chunk of exposure behind it, as GigE Vision lays them out: data, id, length."""
    return image + struct.pack(">II", 1, len(image)) + struct.pack(">d", exposure_us) + struct.pack(">II", 0x1002, 8)


def register(name: str, address: int, kind: str, length: int, port: str = "Device", mode: str = "RW") -> str:
    sign = "<Sign>Unsigned</Sign>" if kind == "IntReg" else ""
    return (
        f'<{kind} Name="{name}"><Address>{address}</Address><Length>{length}</Length><AccessMode>{mode}</AccessMode>'
        f"<pPort>{port}</pPort>{sign}<Endianess>BigEndian</Endianess></{kind}>"
    )


DESCRIPTION = f"""<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="Test" VendorName="Test" StandardNameSpace="GEV" SchemaMajorVersion="1" SchemaMinorVersion="1"
 SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" ToolTip="" ProductGuid="1" VersionGuid="2"
 xmlns="http://www.genicam.org/GenApi/Version_1_1">
<Category Name="Root"><pFeature>ExposureTime</pFeature><pFeature>ExposureAuto</pFeature></Category>
<Enumeration Name="ExposureAuto">
<EnumEntry Name="EnumEntry_ExposureAuto_Off"><Value>0</Value><Symbolic>Off</Symbolic></EnumEntry>
<EnumEntry Name="EnumEntry_ExposureAuto_Continuous"><Value>2</Value><Symbolic>Continuous</Symbolic></EnumEntry>
<pValue>ExposureAutoReg</pValue></Enumeration>
<Float Name="ExposureTime"><pIsLocked>ExposureAutoReg</pIsLocked><pValue>ExposureTimeReg</pValue><Min>10</Min><Max>1000000</Max></Float>
<Float Name="ChunkExposureTime"><pValue>ChunkExposureTimeReg</pValue></Float>
{register("ExposureAutoReg", 16, "IntReg", 4)}{register("ExposureTimeReg", 32, "FloatReg", 8)}
{register("ChunkExposureTimeReg", 0, "FloatReg", 8, "ExposurePort", "RO")}
<Port Name="ExposurePort"><ChunkID>1002</ChunkID></Port><Port Name="Device"/></RegisterDescription>"""


def real_nodes() -> tuple[Any, Any]:
    """GenApi's own node map of DESCRIPTION, and the port that must live as long; its `memory`: exposure automatic, 250 us."""
    from genicam.genapi import AbstractPort, EAccessMode, NodeMap  # pyright: ignore[reportMissingImports]

    memory = bytearray(64)
    struct.pack_into(">I", memory, 16, 2)
    struct.pack_into(">d", memory, 32, 250.0)

    class Port(AbstractPort):
        def __init__(self) -> None:
            super().__init__()
            self.memory = memory

        def is_open(self) -> bool:
            return True

        def get_access_mode(self) -> Any:
            return EAccessMode.RW

        def read(self, address: int, length: int) -> bytes:
            return bytes(memory[address : address + length])

        def write(self, address: int, value: bytes) -> None:
            memory[address : address + len(value)] = value

    nodes = NodeMap()
    nodes.load_xml_from_string(DESCRIPTION)
    port = Port()
    nodes.connect(port, "Device")
    return nodes, port
