"""Memory and GL objects over thousands of pictures in which lights, objects and a lamp move and maps change their resolution.

python -m bench.endurance [FRAMES]
"""

import sys
import time
from pathlib import Path

import numpy as np

from tests.support.gl_objects import gl_objects
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet
from vemlight.light.sphere import direction_from_angles, quaternion_xyz
from vemlight.renderer.accumulation import MapLights
from vemlight.renderer.frame import AccumulationPass, FrameInput, ToneRequest
from vemlight.renderer.frame_sequence import FrameSequence
from vemlight.renderer.renderer import Renderer
from vemlight.renderer.scene.scene import load_scene
from vemlight.renderer.scene.scene_pose import scene_pose
from vemlight.runtime.poses import Pose
from vemlight.settings import Renderer as Settings

SCENES = Path(__file__).parents[1] / "services" / "renderer" / "scene" / "scenes"
COUNTS = (12, 40, 5, 70)  # lights: the atlas is made again when it has too few tiles
POWER_SWING = 3.0  # amplitude of the logarithm of a light's power: each has maps of three resolutions in turn
REPORTS = 20


def resident_mb() -> float:
    """Memory of this process that is in RAM."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 1e6


def sky(count: int, turn: float) -> LightSet:
    """Lights spread over the hemisphere that rotate by `turn` rad and whose power swings."""
    k = np.arange(count) + 0.5
    power = np.exp(POWER_SWING * np.sin(k + 3 * turn))
    irradiance = np.outer(power / power.sum(), np.full(3, 3.0))
    return LightSet.of(np.arange(count), direction_from_angles(np.arccos(k / count), k * 2.4 + turn), irradiance)


class MovingScene:
    """A scene with a lamp in which everything moves."""

    def __init__(self, frame_ms: float) -> None:
        scene = load_scene(SCENES / "headlights.toml")
        lamp = scene.luminaires[0]
        scene = scene._replace(luminaires=(lamp._replace(table=type(lamp.table)(samples=4, shadow_map=16)),), objects=scene.objects[:-1])
        self._scene = scene
        self._frames = FrameSequence(Renderer(scene, Settings(width=32, height=24, light_regions=4, frame_ms=frame_ms)))
        self._light = MapLights(np.ones((6, 12, 3), np.float32), "hemisphere")
        self._adaptation = None

    def frame(self, k: int) -> None:
        turn = 0.01 * k
        ball = Pose(
            name="ball", position=(3.6 + np.sin(turn), -0.5 + np.cos(turn), 0.6), rotation=quaternion_xyz((0.0, 57 * turn, 0.0))
        )
        lamp = Pose(
            name="left headlight", position=(-0.25, 0.45, 0.7), rotation=quaternion_xyz((0.0, 95.0, 20 * np.sin(turn))), power=1 + k % 2
        )
        lights: LightSet | AccumulationPass = sky(COUNTS[k // 100 % len(COUNTS)], turn)
        if k % 50 == 49:  # a pause
            lights = AccumulationPass(self._light, k % 64)
        environment = EnvironmentMap(np.full((6, 12, 3), 1 + k % 2, np.float32), "hemisphere") if k % 3 == 0 else None
        tone = ToneRequest(self._adaptation, 0.0, 0.04)
        pose = scene_pose(self._scene, k / 25, (ball, lamp))
        self._adaptation = self._frames.draw(FrameInput(lights, pose, environment, tone=tone, linear=False)).adaptation

    def objects(self) -> tuple[int, ...]:
        return gl_objects(self._frames.renderer._context)

    def release(self) -> None:
        self._frames.release()


def main(frames: int) -> None:
    scenes = [MovingScene(0.0), MovingScene(15.0)]
    began_s = time.monotonic()
    print("frames  resident MB  buffers, textures, frames, programs of the first and of the second renderer")
    for k in range(frames + 1):
        if k % max(frames // REPORTS, 1) == 0:
            objects = "  ".join(" ".join(map(str, scene.objects())) for scene in scenes)
            print(f"{k:6d}  {resident_mb():11.1f}  {objects}  {time.monotonic() - began_s:.0f} s", flush=True)
        scenes[k % 2].frame(k)
    for scene in scenes:
        scene.release()


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
