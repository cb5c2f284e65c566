"""Mutants of the viewer."""

from tests.mutants.mutant import mutants_of

VIEWER = "services/viewer/"

MUTANTS = [
    *mutants_of(VIEWER + "liveness.py", "tests/test_viewer_liveness.py", [
        ("stalled doubled", "MIN_STALL_S = 1.0", "MIN_STALL_S = 2.0"),
        ("stalled halved", "MIN_STALL_S = 1.0", "MIN_STALL_S = 0.5"),
        ("steps of a slow service", "SLOW_STEPS = 3", "SLOW_STEPS = 6"),
        ("lossless", 'float("inf") if self._lossless else', "0.1 if self._lossless else"),
        ("finished services are healthy", '("live", "finished")', '("live",)'),
        ("steps of a slow service halved", "SLOW_STEPS = 3", "SLOW_STEPS = 1.5"),
        ("slow steps", "(last.status.step_ms or 0.0) / 1e3", "0.0"),
    ]),
    *mutants_of(VIEWER + "pictures.py", "tests/test_viewer_pictures.py", [
        ("key doubled", "KEY = 0.20", "KEY = 0.40"),
        ("white doubled", "WHITE = 6.0", "WHITE = 12.0"),
        ("adaptation doubled", "ADAPT = 0.15", "ADAPT = 0.30"),
        ("adaptation halved", "ADAPT = 0.15", "ADAPT = 0.075"),
        ("darkest cells x 1000", "DARK = 1e-6", "DARK = 1e-3"),
        ("linear steps", "LINEAR_STEPS = 4096", "LINEAR_STEPS = 512"),
        ("quality halved", "QUALITY = 88", "QUALITY = 44"),
        ("quality near the top", "QUALITY = 88", "QUALITY = 97"),
        ("azimuth seam", 'mode="wrap"', 'mode="edge"'),
        ("the pole", "codes.shape[1] // 2, axis=1)", "0, axis=1)"),
        ("equation 4", "(1 + y * to_key / WHITE**2)", "(1 + y * to_key / WHITE)"),
    ]),
    *mutants_of(VIEWER + "environment_feed.py", "tests/test_environment_feed.py", [
        ("as often as it comes", "PERIOD_S = 1.0", "PERIOD_S = 0.05"),
        ("the same again", "if self._taken and _same(self._taken[0]", "if False and _same(self._taken[0]"),
    ]),
    *mutants_of(VIEWER + "environment_binary.py", "tests/test_environment_feed.py", [
        ("lights are not taken out", "rgb9e5(rest / unit)", "rgb9e5(whole / unit)"),
        ("mantissas of a bit less", "(MANTISSA - exponent)[..., None])", "(MANTISSA - 1 - exponent)[..., None])"),
    ]),
    *mutants_of(VIEWER + "broadcast.py", "tests/test_viewer_broadcast.py", [
        ("never stalled", "return now_s - self._took_all_s > STALL_S", "return False"),
        ("stalled though it takes all", "if not self._transport.get_write_buffer_size():", "if False:"),
        ("sent again unasked", "self.waiting.discard(name)", "self.waiting.add(name)"),
        ("encoded for nobody", "or not any(name in reader.waiting for reader in self._readers)", "or False"),
        ("the old frame again", "if number == self._feeds[name].number > reader.has(name):", "if number > reader.has(name):"),
        ("two bytes of length", "elif length < 2**16:", "elif length <= 2**16:"),
    ]),
    *mutants_of(VIEWER + "meter.py", "tests/test_viewer_meter.py", [
        ("clipped without clipping", "if not clipped_pixels or not", "if not"),
        ("clipped at half", "TOP = 0.98", "TOP = 0.5"),
        ("the page's scale first", "self._header.luminance_scale or look.scale", "look.scale or self._header.luminance_scale"),
        ("a finer histogram", "BINS_PER_STOP = 4", "BINS_PER_STOP = 8"),
        ("glare below its range", '"valid": illuminance >= VALID_FROM_LX', '"valid": True'),
    ]),
    *mutants_of("services/light/glare.py", "tests/test_photometry_of_maps.py", [
        ("threshold of sources halved", "THRESHOLD_CD_M2, PEAK_CD_M2 = 2000.0,", "THRESHOLD_CD_M2, PEAK_CD_M2 = 1000.0,"),
        ("no peaks", "50_000.0  # of a glare source", "1e9  # of a glare source"),
        ("joined twice as far", "JOINED_RAD = 0.1", "JOINED_RAD = 0.8"),
        ("joined where they touch", "JOINED_RAD = 0.1", "JOINED_RAD = 0.02"),
        ("sources behind the eye", "elements.directions @ view.astype(np.float32) > 0", "elements.directions[:, 0] > -2"),
        ("position index above and below", "np.where(above >= 0, guth,", "np.where(above < 0, guth,"),
        ("the map's edges", "borderValue=0)", "borderValue=1)"),
    ]),
    *mutants_of("services/light/colour_temperature.py", "tests/test_photometry_of_maps.py", [
        ("sign of Duv", "np.where(above, duv, -duv)", "np.where(above, -duv, duv)"),
        ("far colours", "FARTHEST_DUV = 0.05", "FARTHEST_DUV = 0.5"),
        ("the chord after alone", "np.array([-1, 0])", "np.array([0, 0])"),
    ]),
    *mutants_of("services/light/map_elements.py", "tests/test_photometry_of_maps.py", [
        ("planes that face away", "np.maximum(elements.directions @ normal.astype(np.float32), 0)", "np.abs(elements.directions @ normal)"),
        ("samples as large as cells", "part = 1 / SUBCELLS**2", "part = 1.0"),
        ("fine maps not averaged", "MAX_ROWS = 360", "MAX_ROWS = 5000"),
    ]),
    *mutants_of(VIEWER + "authentication.py", "tests/test_viewer_authentication.py tests/test_viewer.py tests/test_lights_out.py", [
        ("foreign pages", "is_origin(origin, scheme, hosts[0]))", "True)"),
        ("pages elsewhere everywhere", 'settings.origins if request.path == "/ws" else ()', "settings.origins"),
        ("a page's port", "parts.hostname, parts.port or PORTS[parts.scheme]", "parts.hostname, 0"),
        ("foreign names", "if len(hosts) != 1 or not known_host(hosts[0], names):", "if False:"),
        ("wrong tokens", "if not allowance.has():", "if False:"),
        ("the token as a cookie", "self.cookie = cookie_of(token) if token", "self.cookie = token if token"),
        ("any token", "return hmac.compare_digest(given.encode(errors=\"replace\"), token.encode())", "return bool(given)"),
        ("the cookie for scripts", "httponly=True", "httponly=False"),
        ("machines' names", "return name in names", "return True"),
    ]),
    *mutants_of(VIEWER + "connections.py", "tests/test_viewer_connections.py", [
        ("connections of an address", "if len(of_address) >", "if False and len(of_address) >"),
        ("all connections", "elif len(self._open) > limit:", "elif False:"),
        ("busy connections", "if not connection.is_busy), new)", "if True), new)"),
        ("bytes", "if self._bytes.take(len(data) - expected):", "if True:"),
        ("headers that do not come", "self._expect_request(HEADER_S)", "pass"),
        ("the next request", "self._expect_request(IDLE_S)", "pass"),
        ("neighbours in a network", "IPV6_PREFIX = 64", "IPV6_PREFIX = 128"),
    ]),
    *mutants_of(VIEWER + "feeds.py", "tests/test_viewer_feeds.py", [
        ("frames encoded once", "if self._tried != self.number:", "if True:"),
        ("a frame again in place of a later one", "if found > number:", "if True:"),
    ]),
    *mutants_of(VIEWER + "saved_settings.py", "tests/test_saved_settings.py", [
        ("the token", 'token=""))', "token=saved.viewer.token))"),
        ("a stream's password", "source=shown)})", "source=part.source)})"),
        ("the filter", '"none" if control.filtered is False', '"none" if control.filtered'),
        ("the settings' own poses", "(*renderer.poses, *control.poses)", "control.poses"),
        ("no masks", "if control.masks is None else", "if not control.masks else"),
    ]),
    *mutants_of(VIEWER + "web.py", "tests/test_viewer.py", [
        ("messages without a pause", "if not messages.take():", "if False:"),
        ("forms of other pages", 'if request.content_type != "application/json":  # what', "if False:  # what"),
    ]),
    *mutants_of(VIEWER + "uploads.py", "tests/test_viewer_uploads.py", [
        ("names like our own", " and not OWN.fullmatch(stem)", ""),
        ("removed while decoded", "if self._uploads.get(number) is not upload:", "if False:",
         "the folder is gone then, which is refused too"),
    ]),
    *mutants_of(VIEWER + "upload_handlers.py", "tests/test_viewer_uploads.py", [
        ("any byte keeps a place", "while block and len(block) < LEAST and", "while False and"),
    ]),
    *mutants_of(VIEWER + "meter.py", "tests/test_viewer_meter.py", [
        ("as bright as float32", "np.minimum(environment.radiance, np.float32(BRIGHTEST))", "environment.radiance"),
    ]),
    *mutants_of("services/light/near_lights.py", "tests/test_near_lights.py", [
        ("as far as float32", "MAX_METRES = 1e6", "MAX_METRES = 1e7"),
        ("as strong as float32", "MAX_INTENSITY = 1e30", "MAX_INTENSITY = 1e34"),
    ]),
]
