"""Runs of scenes that move: poses sent to the page's address, a pause that converges, a video at the end of a run."""

import json
import os
import signal
from collections.abc import Callable
from pathlib import Path
from urllib.request import Request, urlopen

import av
import numpy as np

from tests.support.gltf_files import AnimatedTriangle
from tests.support.processes import LOADED_S, MessageListener, children, wait_until
from vemlight.light.images import read_radiance
from vemlight.runtime import wire

COUNT = 16  # frames: so many that a renderer can be killed among them
CAMERA = "[camera]\nfrom = [0.0, -7.0, 4.0]\nat = [0.0, 0.0, 1.0]\n"
GROUND = '[[mesh]]\nshape = "plane"\nscale = 3.0\n'


def send_control(port: int, **message) -> None:
    body = json.dumps(message).encode()
    with urlopen(Request(f"http://127.0.0.1:{port}/control", body, {"Content-Type": "application/json"}), timeout=LOADED_S) as answer:
        assert answer.status == 200


def next_image(listener: MessageListener, true: Callable[[wire.ImageMessage], object] = lambda image: True) -> wire.ImageMessage:
    image = listener.next(wire.ImageMessage, true)
    assert isinstance(image, wire.ImageMessage)
    return image


def test_poses_reach_the_picture_and_a_pause_refines_it(run, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(CAMERA + GROUND + '[[mesh]]\nshape = "box"\nscale = 0.4\nat = [0.0, 0.0, 0.4]\n')
    settings, process = run(renderer={"scene": str(scene), "picture": "linear16"})
    listener = MessageListener(settings, "image")
    try:
        image = next_image(listener)
        assert image.linear
        assert [found.name for found in image.objects] == ["plane", "box"]
        there = {"name": "box", "position": [1.0, 0.0, 0.4], "rotation": [0.0, 0.0, 0.6, 0.8]}
        send_control(settings.viewer.port, poses=[there])
        image = next_image(listener, lambda image: image.objects[1].position == (1.0, 0.0, 0.4))
        assert image.report.drawn_lights == 16
        send_control(settings.viewer.port, paused=True)
        next_image(listener, lambda image: image.report.drawn_lights > 200)  # some passes
        send_control(settings.viewer.port, paused=False, poses=None)
        next_image(listener, lambda image: image.report.drawn_lights == 16 and image.objects[1].position == (0.0, 0.0, 0.4))
    finally:
        listener.close()
        process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=10) == 0


def test_an_animated_run_is_the_same_though_its_renderer_is_killed(run, tmp_path):
    scene = tmp_path / "scene.toml"
    AnimatedTriangle(scale=[2.0, 2.0, 2.0]).move(1, "translation", [0, 0.4], [[-1, 1, 0], [1, 1, 0]]).write(tmp_path / "animated.gltf")
    scene.write_text(CAMERA + GROUND + '[[mesh]]\nfile = "animated.gltf"\n')
    sections = {"renderer": {"scene": str(scene), "video": str(tmp_path / "video.mp4")}}

    def frames(out: Path, kill: bool) -> list[np.ndarray]:
        _, process = run("--frames", str(COUNT), "--out", str(out), **sections)
        if kill:
            wait_until((out / "frame_0001.exr").exists, "the second frame")  # a listener may come too late for messages
            os.kill(children(process.pid)["renderer"], signal.SIGKILL)
        _, errors = process.communicate(timeout=LOADED_S)
        assert process.returncode == 0, errors.decode()
        return [read_radiance(out / f"frame_{k:04d}.exr")[0] for k in range(COUNT)]

    whole, killed = frames(tmp_path / "a", kill=False), frames(tmp_path / "b", kill=True)
    assert all(np.array_equal(a, b) for a, b in zip(whole, killed, strict=True))
    assert not np.array_equal(whole[0], whole[5])
    with av.open(str(tmp_path / "video.mp4")) as container:
        assert len(list(container.decode(video=0))) == COUNT
