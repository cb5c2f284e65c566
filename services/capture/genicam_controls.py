"""A GenICam camera's controls (features of the SFNC, the Standard Features Naming Convention): what adjusts itself is switched off, what
is asked for set, read back, and all restored. Values are those of the standard: times in us, gains in the camera's own unit, mostly dB.
"""

from collections.abc import Mapping
from typing import Any

from vemlight.errors import UserError
from vemlight.files import notice

READABLE, WRITABLE, ABSENT = (3, 4), (2, 4), 0  # access modes of GenApi: NI, NA, WO, RO, RW are 0 to 4
MANUAL: dict[str, Any] = {  # what adjusts itself or bends the response, and the value that stops it, in this order
    "ExposureAuto": "Off", "ExposureMode": "Timed", "GainAuto": "Off", "GainAutoBalance": "Off", "BalanceWhiteAuto": "Off",
    "BlackLevelAuto": "Off", "BlackLevelAutoBalance": "Off", "GammaEnable": False, "Gamma": 1.0, "LUTEnable": False,
    "AcquisitionMode": "Continuous",
}  # fmt: skip
TOLD = ("Gain", "GainRaw", "BlackLevel", "BlackLevelRaw")  # recorded beside what was set
EXPOSURES = ("ExposureTime", "ExposureTimeAbs", "ExposureTimeRaw")  # SFNC 2, SFNC 1, counts of ExposureTimeBaseAbs
US = 1e-6
ALIKE = 0.02  # between a number that was asked for and the one that is read back: exposures go by rows, of 10 to 30 us. 0.01 to 0.05 do


class GenicamControls:
    """The features of an open camera, while they are ours; as `vemlight.capture.camera_controls.CameraControls`."""

    def __init__(self, nodes: Any, path: str, earlier: "GenicamControls | None" = None) -> None:
        """nodes: the node map of the camera. earlier: its controls before an outage, after which it may be as they had set it."""
        self._nodes, self._path = nodes, path
        self._asked: dict[str, Any] = {}
        self.values: dict[str, Any] = {}
        # what was there before, in the order of setting: a selector comes before what it selects; an outage changes nothing of it
        self._before: list[tuple[str, Any]] = earlier._before if earlier else []
        self._remembers = earlier is None
        self._kept: set[str] = set()  # names of those that may be written again and again
        self.time_control = next((name for name in EXPOSURES if self.read(name) is not None), EXPOSURES[0])
        self.unit_s = US if self.time_control != "ExposureTimeRaw" else (self.read("ExposureTimeBaseAbs") or 0) * US

    def hold(self, wanted: Mapping[str, int]) -> None:
        """Stops what adjusts itself and sets what is wanted. Raises UserError as CameraControls does."""
        for name in wanted:
            self._node(name)
        for name, value in MANUAL.items():
            node = getattr(self._nodes, name, None)
            if name not in wanted and node is not None and node.get_access_mode() in WRITABLE:  # others are as the camera is built
                self.settle(name, value)
                self._asked[name] = value
        for name, value in wanted.items():
            self._check(name, value)
            self.settle(name, value)
            self._asked[name] = value

    def read_back(self) -> None:
        """Fills `values`; notices tell what does not obey. When all else is set: a frame rate may shorten an exposure."""
        names = (*self._asked, *TOLD, self.time_control)
        self.values = {name: value for name in names if (value := self.read(name)) is not None}
        refused = [name for name, value in self._asked.items() if not self._is(name, value)]
        if refused:
            told = ", ".join(f"{name} is {self.values.get(name, 'not readable')}" for name in refused)
            notice(f"{self._path}: does not obey: {told}; its light may change by itself")
        if self.exposure_s is None:
            notice(f"{self._path}: does not tell its exposure; where it adjusts itself, its light is right in proportion alone")

    @property
    def exposure_s(self) -> float | None:
        """The exposure time that was read back, None where the camera tells none."""
        count = self.values.get(self.time_control)
        return count * self.unit_s if count is not None and self.unit_s else None

    @property
    def is_linear(self) -> bool:
        """Whether no gamma bends the codes, so far as the camera tells."""
        enabled, gamma = self.read("GammaEnable"), self.read("Gamma")
        return enabled is False or gamma == 1.0 or (enabled is None and gamma is None)

    def limits(self, name: str) -> tuple[float, float]:
        """The least and the largest value of a number. Raises UserError for a control that is none, or that the camera does not have."""
        node = self._node(name)
        try:
            return node.min, node.max
        except Exception as error:
            raise UserError(f"{self._path}: {name} is no number that can be set now; name another control") from error

    def write(self, name: str, value: float) -> None:
        """Sets a control without asking whether it obeyed."""
        if name not in self._kept:
            self._kept.add(name)
            self._remember(name)
        self._set(name, value)

    def written(self, name: str, value: float) -> Any:
        """Sets a control; returns what is read back."""
        self.write(name, value)
        return self.read(name)

    def settle(self, name: str, value: Any) -> bool:
        """Sets a feature, to be restored. Whether it has the value then."""
        if self.read(name) != value:
            self._remember(name)
            self._set(name, value)
        return self._is(name, value)

    def read(self, name: str) -> Any:
        """The value of a feature: a number, a text, or whether it is on; None where it cannot be read."""
        try:
            node = getattr(self._nodes, name)
            return node.value if node.get_access_mode() in READABLE else None
        except Exception:  # GenApi's own classes, and AttributeError
            return None

    def restore(self) -> None:
        """Sets everything to what it was, backwards, so that what was automatic takes over last."""
        while self._before:
            name, value = self._before.pop()
            if value is not None and self.read(name) != value:
                self._set(name, value)
        self._kept.clear()

    def _check(self, name: str, value: int) -> None:
        if isinstance(self.read(name), str):
            raise UserError(f"{self._path}: {name} is {self.read(name)}, and no number; set it by the camera maker's program")
        if isinstance(self.read(name), bool):
            return
        least, most = self.limits(name)
        if not least <= value <= most:
            raise UserError(f"{self._path}: {name} = {value} is not in {least:g} .. {most:g}; choose a number in it")

    def _node(self, name: str) -> Any:
        node = getattr(self._nodes, name, None)
        if node is None or not hasattr(type(node), "value") or node.get_access_mode() == ABSENT:
            raise UserError(f"{self._path}: has no control {name[:40]}; its maker's program lists them, such as ExposureTime, Gain")
        return node

    def _remember(self, name: str) -> None:
        if self._remembers:
            self._before.append((name, self.read(name)))

    def _is(self, name: str, value: Any) -> bool:
        now = self.read(name)
        return abs(now - value) <= ALIKE * abs(value) if isinstance(now, float) else now == value

    def _set(self, name: str, value: Any) -> None:
        try:  # whether it obeyed is read back
            node = getattr(self._nodes, name)
            node.value = type(node.value)(value)
        except Exception:
            return
