"""Mutants of what is made for other programs."""

from tests.mutants.mutant import mutants_of

EXCHANGE = "services/exchange/"

MUTANTS = [
    *mutants_of("services/light/lights_reader.py", "tests/test_lights_reader.py", [
        ("time that stands", "if frame.time_s <= time_s:", "if frame.time_s < time_s:"),
        ("ids below 0", "not 0 <= min(ids)", "not -9 <= min(ids)"),
        ("negative light", "(irradiance < 0,", "(irradiance < -9,"),
        ("ids twice", "if len(ids) < len(row.lights):", "if False:"),
        ("a bad line passed over", "    if late:\n        raise late\n", "    del late\n"),
        ("what is possible unlooked at", "not _impossible(LightSet(", "bool(LightSet("),
        ("no frame", "    if time_s < 0:\n", "    if False:\n"),
    ]),
    *mutants_of(EXCHANGE + "punctual.py", "tests/test_exchange_punctual.py", [
        ("a larger sun", "SUN_DEG = 0.53", "SUN_DEG = 0.6"),
        ("wider than a hemisphere", "WHOLE_DEG = 180.0", "WHOLE_DEG = 360.0"),
        ("half the angle", "4 * np.degrees", "2 * np.degrees"),
        ("digits near straight down", "np.where(z < 0, across / (length + np.abs(z)), length + z)", "length + z"),
    ]),
    *mutants_of(EXCHANGE + "usd_file.py", "tests/test_export.py", [
        ("light after a light's end", "np.concatenate([before, after])", "before"),
        ("light before its start", "np.concatenate([before, after])", "after"),
        ("darkness at another light's end", "lights.bounds + np.searchsorted(beside, starts)", "lights.bounds"),
        ("Blender's intensity", "Factors(4, 2)", "Factors(2, 2)"),
        ("Blender's angle", "Factors(4, 2)", "Factors(4, 1)"),
        ("codes off the frames", "ON_A_FRAME = 0.02", "ON_A_FRAME = 0.0"),
        ("the dome turned the other way", "(0.5, 0.5, 0.5, 0.5)", "(-0.5, 0.5, 0.5, 0.5)"),
        ("no 1000/1001", "round(rate * 1.001) / 1.001", "round(rate)"),
    ]),
    *mutants_of(EXCHANGE + "light_columns.py", "tests/test_export.py", [
        ("all lights at once", "int(np.searchsorted(bounds, ", "len(bounds) + 0 * int(np.searchsorted(bounds, "),
        ("frames of another light", "prepend=-1)", "prepend=0)"),
    ]),
    *mutants_of(EXCHANGE + "usd_text.py", "tests/test_export.py", [
        ("eight digits", "10.0 ** (8 - np", "10.0 ** (7 - np"),
        ("ten of ten", "grown = digits >= 1e9", "grown = digits > 1e9"),
    ]),
    *mutants_of(EXCHANGE + "usd_crate.py", "tests/test_export.py", [
        ("the real part first", "values[:, [1, 2, 3, 0]]", "values[:, [0, 1, 2, 3]]"),
        ("times of another light", "if self._times[0] is not attribute.frames:", "if self._times[0] is None:"),
        ("a prim in a prim", "1 + end - begin, field_set", "end - begin, field_set"),
        ("misaligned", "bytes(-self._at % 8)", "bytes(3)"),
    ]),
    *mutants_of(EXCHANGE + "gltf_lights.py", "tests/test_export.py", [
        ("lumens", "LM_PER_W = 683.0", "LM_PER_W = 680.0"),
        ("z up", "np.array([1, 1, -1], np.float32)", "np.array([1, 1, 1], np.float32)"),
        ("a chunk of any length", 'b" " * (-len(content) % 4)', 'b""'),
    ]),
    *mutants_of(EXCHANGE + "osc.py", "tests/test_osc.py", [
        ("bundles over a packet", "LIGHTS = 20", "LIGHTS = 25"),
        ("no NUL behind a text", "bytes(4 - len(text) % 4)", "bytes(-len(text) % 4)"),
    ]),
    *mutants_of(EXCHANGE + "line_sender.py", "tests/test_line_sender.py", [
        ("a queue for a slow reader", "SEND_BUFFER = 64 * 1024", "SEND_BUFFER = 64 * 2**20"),
        ("the rest of a line to the next reader", "self._socket, self._rest = None, memoryview(b\"\")", "self._socket = None"),
    ]),
    *mutants_of("services/light/lights_binary.py", "tests/test_lights_out.py tests/test_clients_js.py", [
        ("another layout", "KIND, LAYOUT = 3, 1", "KIND, LAYOUT = 3, 2"),
        ("hemispheres for spheres", '("hemisphere", "sphere")', '("sphere", "hemisphere")'),
    ]),
    *mutants_of("services/light/lights_binary.py", "tests/test_placed_lights.py tests/test_viewer_state.py", [
        ("near lights out of place", "(points.at, points.intensity, points.radius)", "(points.intensity, points.at, points.radius)"),
    ]),
    *mutants_of("vemlight_client.py", "tests/test_vemlight_client.py", [
        ("a short queue", "QUEUE = 1000", "QUEUE = 4"),
        ("any version", 'if header.get("version", 1) != VERSION:', "if False:"),
    ]),
    *mutants_of(EXCHANGE + "fewer_lights.py", "tests/test_fewer_lights.py", [
        ("turns", "STAY = 1.25", "STAY = 1.0"),
        ("kept for ever", "STAY = 1.25", "STAY = 4.0"),
        ("the light of others is lost", "np.add.at(irradiance, owner, ", "np.add.at(irradiance, owner, 0 * "),
        ("the farthest owner", "np.argmax(directions @ directions[kept].T", "np.argmin(directions @ directions[kept].T"),
    ]),
    *mutants_of(EXCHANGE + "relay.py", "tests/test_relay.py", [
        ("frames over the limit", "HEAD_BYTES = 850", "HEAD_BYTES = 300"),
        ("the sampler's count", "header, frames=self.frames", "header, frames=header.frames"),
        ("every frame", "1 / relayed.feed.rate_hz if relayed.feed.rate_hz else 0.0", "0.0"),
    ]),
    *mutants_of("services/renderer/output/exr_attributes.py", "tests/test_exr_attributes.py", [
        ("halves of any number", "HALF_MAX = 65504.0", "HALF_MAX = 1e9"),
        ("hours beyond a day", "seconds // 3600 % 24", "seconds // 3600"),
        ("frames over 30", "frame * 30 // counted if counted > 30 else frame", "frame"),
    ]),
]  # fmt: skip
