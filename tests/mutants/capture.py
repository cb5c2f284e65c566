"""Mutants of light, cameras and files of frames."""

from tests.mutants.mutant import mutants_of

CAPTURE = "services/capture/"

MUTANTS = [
    *mutants_of("services/light/bright_cells.py", "tests/test_bright_cells.py", [
        ("azimuth seam", "offset = (j - col + cols / 2) % cols - cols / 2", "offset = j - col"),
        ("sub-cells halved", "SUBCELLS = 3", "SUBCELLS = 2"),
        ("negative flux", "np.isfinite(flux) & (flux > 0)", "np.isfinite(flux)"),
        ("nan in flux", "np.isfinite(flux) & (flux > 0)", "~np.isinf(flux)"),
    ]),
    *mutants_of("services/light/images.py", "tests/test_images.py", [
        ("side doubled", "MAX_SIDE = 16384", "MAX_SIDE = 32768"),
        ("side x 100", "MAX_SIDE = 16384", "MAX_SIDE = 1638400"),
        ("pixel limit x 100", "MAX_PIXELS = 2**27", "MAX_PIXELS = 100 * 2**27"),
        ("pixel limit doubled", "MAX_PIXELS = 2**27", "MAX_PIXELS = 2**28"),
        ("order of channels", "(pixels[..., ::-1])\n\n\ndef read_codes", "(pixels)\n\n\ndef read_codes"),
    ]),
    *mutants_of("services/light/colour.py", "tests/test_colour.py", [
        ("luminance of red", "[0.2126, 0.7152, 0.0722]", "[0.2226, 0.7052, 0.0722]"),
        ("slope of sRGB", "SRGB_SLOPE = 12.92", "SRGB_SLOPE = 12.0"),
        ("offset of sRGB", "SRGB_OFFSET = 0.055", "SRGB_OFFSET = 0.06"),
        ("gamma of sRGB", "SRGB_GAMMA = 2.4", "SRGB_GAMMA = 2.2"),
    ]),
    *mutants_of("services/light/sphere.py", "tests/test_sphere.py", [
        ("an azimuth of 2 pi", "np.where(phi >= 2 * np.pi, 0.0, phi)", "phi"),
        ("middle of a cell", "theta = (np.arange(rows) + 0.5) * (SPAN", "theta = np.arange(rows) * (SPAN"),
    ]),
    *mutants_of(CAPTURE + "sequence.py", "tests/test_sequence.py", [
        ("a half-written line of the manifest", 'if number == len(lines) and not line.endswith(b"\\n"):', "if False:"),
        ("any line of the manifest", 'if number == len(lines) and not line.endswith(b"\\n"):', "if number == len(lines):"),
        ("digests", "if hashlib.sha256(path.read_bytes()).hexdigest() != sha256:", "if False:"),
        ("numbers that are missing", "if int(after) != int(digits) + 1:", "if int(after) > int(digits) + 2:"),
        ("order of numbers", "key=lambda row: int(row[1])", "key=lambda row: row[1]"),
    ]),
    *mutants_of(CAPTURE + "recorder.py", "tests/test_recorder.py", [
        ("a half-written line of the manifest kept", "            self._manifest.truncate(end)\n", ""),
        ("an image that the manifest does not list", "            path.unlink(missing_ok=True)\n            raise", "            raise"),
        ("queue doubled", "QUEUE_FRAMES = 8", "QUEUE_FRAMES = 16"),
        ("a recording overwritten", "if (folder / MANIFEST).exists():", "if False:"),
    ]),
    *mutants_of(CAPTURE + "source.py", "tests/test_source.py", [
        ("time_s not divided by speed", "self._entries[k].time_s / self._speed", "self._entries[k].time_s"),
        ("fps not multiplied by speed", "self.fps = settings.fps * settings.speed", "self.fps = settings.fps"),
        ("rate of a header doubled", "MAX_FPS = 1000", "MAX_FPS = 2000"),
        ("files not checked", "if self._entries and k not in self._verified:", "if False:"),
        ("the last frame", "end = min(settings.end or len(paths), len(paths))", "end = len(paths)"),
    ]),
    *mutants_of(CAPTURE + "fisheye.py", "tests/test_fisheye.py tests/test_frames.py", [
        ("Bayer weights by the wrong lattice", "(n % 2, n // 2) for n in range(4)", "(n // 2, n % 2) for n in range(4)"),
        ("area of a green pixel", '"G": (2, 1)', '"G": (2, 2)'),
        ("end of a lit row", "weights.shape[1] - lit[:, ::-1].argmax(axis=1)", "weights.shape[1] - lit[:, ::-1].argmax(axis=1) - 1"),
    ]),
    *mutants_of(CAPTURE + "frames.py", "tests/test_frames.py", [
        ("bright cells doubled", "BRIGHT_FRACTION = 1 / 500", "BRIGHT_FRACTION = 1 / 250"),
        ("bright cells halved", "BRIGHT_FRACTION = 1 / 500", "BRIGHT_FRACTION = 1 / 1000"),
        ("most bright cells doubled", "MAX_BRIGHT_CELLS = 64", "MAX_BRIGHT_CELLS = 128"),
        ("codes above the response", "> response.top:", "> 2 * response.top:"),
    ]),
    *mutants_of(CAPTURE + "polar.py", "tests/test_polar.py", [
        ("thin overlaps", "MIN_OVERLAP = 1e-9", "MIN_OVERLAP = 1e-16"),
        ("azimuth seam", "columns = (by_col.index - (width // 2) - 1) % width", "columns = (by_col.index - (width // 2)) % width"),
    ]),
    *mutants_of(CAPTURE + "response.py", "tests/test_response.py", [
        ("rounding of a code", "np.clip(np.rint(signal), 0, response.top)", "np.clip(np.floor(signal), 0, response.top)"),
        ("largest code", "return 2**self.bits - 1", "return 2**self.bits"),
        ("a log response without c", "response.c <= 0:", "response.c < 0:"),
    ]),
    *mutants_of(CAPTURE + "simulation/motion.py", "tests/test_motion.py", [
        ("animation keys cut to the first", "if len(keys) == 1:", "if True:"),
        ("keys out of order", "after <= before", "after < before"),
        ("after the last key", "np.clip(time_s, times[0], times[-1])", "np.clip(time_s, times[0], times[-1] - 0.1)"),
    ]),
    *mutants_of("services/plate/video_source.py", "tests/test_plate.py", [
        ("side doubled", "LONGEST_SIDE = 8192", "LONGEST_SIDE = 16384"),
        ("bytes doubled", "MOST_BYTES = 64 * 2**20", "MOST_BYTES = 128 * 2**20"),
        ("a film's frame rate", "0 < self.fps <= 1000", "0 <= self.fps"),
    ]),
]
