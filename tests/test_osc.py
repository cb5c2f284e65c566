"""Open Sound Control: decoded here by the specification's text, and by python-osc where it is installed."""

import numpy as np
import pytest

from tests.support.exchange import messages_of
from vemlight.exchange.osc import MAX_BYTES, osc_bundles
from vemlight.exchange.punctual import angles_deg
from vemlight.light.light_set import LightSet


def lights_of(count: int) -> LightSet:
    random = np.random.default_rng(count)
    directions = random.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    covariances = np.tile([1e-3, 0, 0, 1e-3, 0, 0], (count, 1))
    return LightSet.of(random.permutation(count) + 5, directions, random.random((count, 3)), covariances)


@pytest.mark.parametrize("count", [0, 1, 20, 21, 72])
def test_every_light_is_in_a_bundle_that_one_packet_holds(count):
    lights = lights_of(count)
    bundles = list(osc_bundles(lights, 2**31 + 9))
    assert len(bundles) == max(1, -(-count // 20))
    assert max(map(len, bundles)) <= MAX_BYTES == 1400
    shown = []
    for bundle in bundles:
        head, *rest = messages_of(bundle)
        assert head == ("/vemlight/frame", [9, count])
        assert {address for address, _ in rest} <= {"/vemlight/light"}
        shown += [arguments for _, arguments in rest]
    assert [arguments[0] for arguments in shown] == lights.ids.tolist()
    numbers = np.array([arguments[1:] for arguments in shown], np.float32).reshape(count, 7)
    assert np.array_equal(numbers[:, :3], lights.directions)
    assert np.array_equal(numbers[:, 3:6], lights.irradiance)
    assert np.allclose(numbers[:, 6], angles_deg(lights), rtol=1e-6)


def test_python_osc_reads_the_same():
    osc_bundle = pytest.importorskip("pythonosc.osc_bundle", reason="python-osc is not installed: pip install python-osc")
    lights = lights_of(20)
    (data,) = osc_bundles(lights, 7)
    contents = list(osc_bundle.OscBundle(data))
    assert (contents[0].address, contents[0].params) == ("/vemlight/frame", [7, 20])
    assert [(message.address, message.params[0]) for message in contents[1:]] == [("/vemlight/light", k) for k in lights.ids.tolist()]
    assert np.array_equal(np.array([message.params[1:4] for message in contents[1:]], np.float32), lights.directions)
