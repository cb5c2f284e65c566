"""A page with the modules that draw a scene in a browser, and nothing of a viewer around them."""

import base64
from typing import Any

import msgspec
import numpy as np

from vemlight import settings
from vemlight.light.environment_map import EnvironmentMap
from vemlight.light.light_set import LightSet, NearLights
from vemlight.light.lights_binary import placed_binary
from vemlight.light.near_lights import NearLightSet
from vemlight.renderer.browser.flatten import scene_message
from vemlight.renderer.scene.scene import Scene
from vemlight.runtime import wire
from vemlight.runtime.poses import Pose, View
from vemlight.viewer.environment_binary import environment_binary
from vemlight.viewer.scene_files import scene_files
from vemlight.viewer.web import PAGE, constants_js

ADDRESS = "http://relit.test/"
OPEN = """async () => {
    const [{ loadScene }, { contextOf, SceneDrawing }] = await Promise.all([import("/scene_data.js"), import("/relit_draw.js")]);
    const scene = await loadScene(), { gl, why } = contextOf(document.querySelector("canvas"));
    if (why) throw new Error(why);
    const { lightsFromBytes } = await import("/lights_from_bytes.js"), { environmentFromBytes } = await import("/relit_environment.js");
    Object.assign(window, { scene, gl, drawing: new SceneDrawing(gl, scene), lightsFromBytes, environmentFromBytes });
}"""
DRAW = """async ({ bytes, environment, view, poses, width, height, times }) => {
    drawing.environment.take(environment && await environmentFromBytes(Uint8Array.from(atob(environment), (c) => c.charCodeAt(0)).buffer));
    const { directional: lights, near } = lightsFromBytes(Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0)).buffer), made = [];
    const frame = { view: view ?? scene.cameras[0], lights, near, poses, tone: { scale: 1, white: 0 }, width, height };
    let drawn;
    for (let k = 0; k < times; k++) {
        const began = performance.now();
        drawn = drawing.draw(frame);
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits until it is done
        made.push(performance.now() - began);
    }
    const data = new Uint8Array(drawing.readLinear().buffer);
    let text = "";
    for (let k = 0; k < data.length; k += 32768) text += String.fromCharCode(...data.subarray(k, k + 32768));
    return { pixels: btoa(text), drawn, ms: made, error: gl.getError() };
}"""

SHOW = """({ bytes, width, height }) => {
    const { directional: lights, near } = lightsFromBytes(Uint8Array.from(atob(bytes), (c) => c.charCodeAt(0)).buffer);
    const drawn = drawing.draw({ view: scene.cameras[0], lights, near, poses: [], tone: { scale: 1, white: 0 }, width, height });
    const codes = new Uint8Array(4 * width * height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, codes);
    return [[...drawing.readLinear()], [...codes], drawn];
}"""


class RelitPage:
    """A scene as a browser's page draws it."""

    def __init__(self, page, scene: Scene, drawing: settings.Renderer) -> None:
        header, arrays = scene_message(scene, drawing)
        assert isinstance(header, wire.SceneMessage)
        self.files = scene_files(header, *arrays)
        assert self.files.hash, self.files.text
        self.page, self._size = page, (drawing.width, drawing.height)
        self.drawn: dict[str, int] = {}
        self.frame_ms: list[float] = []
        page.route(f"{ADDRESS}**", self._answer)
        page.goto(ADDRESS)
        page.evaluate(OPEN)

    def _answer(self, route) -> None:
        path = route.request.url.removeprefix(ADDRESS)
        if not path:
            return route.fulfill(content_type="text/html", body="<!doctype html><canvas></canvas>")
        if path == "scene.json":
            return route.fulfill(content_type="application/json", body=self.files.description)
        if path.startswith("scene/"):
            return route.fulfill(content_type="application/octet-stream", body=self.files.data)
        script = constants_js() if path == "constants.js" else (PAGE / path).read_text()
        return route.fulfill(content_type="text/javascript", body=script)

    def picture(
        self,
        lights: LightSet,
        view: View | None = None,
        poses: tuple[Pose, ...] = (),
        near: NearLightSet | None = None,
        times: int = 1,
        environment: EnvironmentMap | None = None,
    ) -> np.ndarray:
        """(height, width, 3) float32, linear. `drawn` and `frame_ms` then say how."""
        width, height = self._size
        asked: dict[str, Any] = {"width": width, "height": height, "times": times}
        asked |= {"view": msgspec.to_builtins(view), "poses": msgspec.to_builtins(poses)}
        asked |= {"bytes": frame_bytes(lights, near), "environment": None}
        if environment is not None:
            asked["environment"] = base64.b64encode(environment_binary(environment, lights)).decode()
        made = self.page.evaluate(DRAW, asked)
        assert made["error"] == 0
        self.drawn, self.frame_ms = made["drawn"], made["ms"]
        return np.frombuffer(base64.b64decode(made["pixels"]), "<f4").reshape(height, width, 4)[..., :3]

    def shown(self, lights: LightSet, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        """The linear picture (height, width, 3) and what the canvas has of it, (height, width, 4) codes."""
        linear, codes, self.drawn = self.page.evaluate(SHOW, {"bytes": frame_bytes(lights), "width": width, "height": height})
        return np.reshape(linear, (height, width, 4))[..., :3], np.reshape(codes, (height, width, 4))


def frame_bytes(lights: LightSet, near: NearLightSet | None = None) -> str:
    """What the page receives of a frame, for its own decoder."""
    placed = NearLights(near, (0.0, 0.0, 0.0)) if near else None
    return base64.b64encode(placed_binary(lights, placed, 1, 0.0, "sphere")).decode()
