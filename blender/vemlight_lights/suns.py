"""Lights as SUN objects, one for each id, in a collection of their own."""

import math
from array import array
from typing import Any

from .feed import Frame

COLLECTION = "vemlight"
KEY = "vemlight_id"  # a custom property of each object; PARKED: of no light at present
PARKED = -1
SUN_RAD = math.radians(0.53)  # the least angle: the sun's


def rotation_to(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """The shortest rotation (w, x, y, z) that turns +Z to a unit vector, half a turn about +X straight down; a SUN shines along -Z."""
    across = math.hypot(x, y)
    if across == 0:
        return (1.0, 0.0, 0.0, 0.0) if z > 0 else (0.0, 1.0, 0.0, 0.0)
    half = math.atan2(across, z) / 2
    sin_half = math.sin(half)
    return (math.cos(half), -y / across * sin_half, x / across * sin_half, 0.0)


def angle_of(covariances: array | None, k: int) -> float:
    """Diameter in rad of the evenly bright disc with the light's extent: a cap of half angle R has the mean (1 + cos R) / 2."""
    if covariances is None:
        return SUN_RAD
    trace = min(max(covariances[6 * k] + covariances[6 * k + 3] + covariances[6 * k + 5], 0.0), 1.0)
    half = 2 * math.asin(math.sqrt(trace / (1 + math.sqrt(1 - trace))))
    return min(max(2 * half, SUN_RAD), math.pi)


class Suns:
    """The objects of one scene. Those whose light ended are parked, with energy 0, and serve the next id.

    Hiding or making objects has Blender sort its dependencies anew: 13 ms more for 300 suns of which 20 change.
    """

    def __init__(self, bpy: Any, scene: Any) -> None:
        """Finds the objects that an earlier connection, or a file, has left."""
        self._bpy = bpy
        self._collection = bpy.data.collections.get(COLLECTION) or bpy.data.collections.new(COLLECTION)
        if self._collection.name not in scene.collection.children:
            scene.collection.children.link(self._collection)
        self._objects: dict[int, Any] = {}
        self._parked: list[Any] = []
        for thing in list(self._collection.objects):
            if thing.type == "LIGHT" and KEY in thing:
                number = int(thing[KEY])
                if number == PARKED or number in self._objects:
                    self._parked.append(thing)
                else:
                    self._objects[number] = thing

    def show(self, frame: Frame, strength: float = 1.0) -> int:
        """Makes the scene's suns those of the frame; how many there are. Raises ReferenceError when one was deleted by hand."""
        here = set(frame.ids)
        for number in [number for number in self._objects if number not in here]:
            self._park(self._objects.pop(number))
        for k, number in enumerate(frame.ids):
            thing = self._objects.get(number)
            if thing is None:
                thing = self._objects[number] = self._wake(number)
            red, green, blue = frame.irradiance[3 * k : 3 * k + 3]
            most = max(red, green, blue)
            light = thing.data
            light.energy = most * strength  # W/m2: Blender's unit is ours
            light.color = (red / most, green / most, blue / most) if most else (1.0, 1.0, 1.0)
            light.angle = angle_of(frame.covariances, k)
            thing.rotation_quaternion = rotation_to(*frame.directions[3 * k : 3 * k + 3])
        return len(frame.ids)

    def _park(self, thing: Any) -> None:
        thing.data.energy = 0.0
        thing[KEY] = PARKED
        self._parked.append(thing)

    def _wake(self, number: int) -> Any:
        name = f"vemlight_{number:04d}"
        if self._parked:
            thing = self._parked.pop()
            thing.name = name
        else:
            light = self._bpy.data.lights.new(name, "SUN")
            thing = self._bpy.data.objects.new(name, light)
            thing.rotation_mode = "QUATERNION"
            self._collection.objects.link(thing)
        thing[KEY] = number
        return thing
