"""Mutants of light, cameras and files of frames."""

from tests.mutants.mutant import mutants_of

CAPTURE = "services/capture/"

MUTANTS = [
    *mutants_of(
        "services/light/bright_cells.py",
        "tests/test_bright_cells.py",
        [
            ("azimuth seam", "offset = (j - col + cols / 2) % cols - cols / 2", "offset = j - col"),
            ("sub-cells halved", "SUBCELLS = 3", "SUBCELLS = 2"),
            ("negative flux", "np.isfinite(flux) & (flux > 0)", "np.isfinite(flux)"),
            ("nan in flux", "np.isfinite(flux) & (flux > 0)", "~np.isinf(flux)"),
        ],
    ),
    *mutants_of(
        "services/light/image_limits.py",
        "tests/test_images.py",
        [
            ("side doubled", "side: int = 16384", "side: int = 32768"),
            ("side x 100", "side: int = 16384", "side: int = 1638400"),
            ("pixel limit x 100", "pixels: int = 2**27", "pixels: int = 100 * 2**27"),
            ("pixel limit doubled", "pixels: int = 2**27", "pixels: int = 2**28"),
            ("free bytes quartered", "free_bytes: int = 64 * 2**20", "free_bytes: int = 16 * 2**20"),
            ("chunks beyond the file", "        if at > len(data):", "        if False:"),
            ("what follows the end", '        if name == b"IEND":', "        if False:"),
            ("ratio of a bomb", "stored_bytes: int, pixel_bytes: int = 12", "stored_bytes: int, pixel_bytes: int = 6"),
        ],
    ),
    *mutants_of(
        "services/light/images.py",
        "tests/test_images.py",
        [
            ("order of channels", "np.ascontiguousarray(pixels[..., ::-1])", "np.ascontiguousarray(pixels)"),
            ("turned by EXIF", "(0 if upright else cv2.IMREAD_IGNORE_ORIENTATION)", "0"),
        ],
    ),
    *mutants_of(
        "services/light/radiance_hdr.py",
        "tests/test_radiance_hdr.py",
        [
            ("half step", "np.float32(0.5)) * unit", "np.float32(0.0)) * unit"),
            ("exposures replace", "scale = scale * _numbers(path, line, 1)", "scale = _numbers(path, line, 1)"),
            ("long runs", "shift += 8", "shift += 0"),
            ("turned rows", 'signs["Y"] == "-"', 'signs["Y"] == "+"'),
            ("primaries ignored", "atol=1e-3)", "atol=1e3)"),
        ],
    ),
    *mutants_of(
        "services/light/exr.py",
        "tests/test_exr.py",
        [
            ("window's left", "cols.start - left", "cols.start"),
            ("cube maps", '.endswith("CUBE")', '.endswith("cube")'),
            ("chromaticities ignored", "REC709, atol=1e-3", "REC709, atol=1e3"),
            ("any layer", "len(MAIN_LAYERS) and sum(", "-1 and sum("),
            ("parts' limit", "MAX_PARTS = 1024", "MAX_PARTS = 10**6"),
            ("channels doubled", "MAX_CHANNELS = 1024", "MAX_CHANNELS = 2048"),
            ("channels not counted", 'area * _bytes_per_pixel(data, attributes["channels"])', "area"),
        ],
    ),
    *mutants_of(
        "services/light/colour.py",
        "tests/test_colour.py",
        [
            ("luminance of red", "[0.2126, 0.7152, 0.0722]", "[0.2226, 0.7052, 0.0722]"),
            ("slope of sRGB", "SRGB_SLOPE = 12.92", "SRGB_SLOPE = 12.0"),
            ("offset of sRGB", "SRGB_OFFSET = 0.055", "SRGB_OFFSET = 0.06"),
            ("gamma of sRGB", "SRGB_GAMMA = 2.4", "SRGB_GAMMA = 2.2"),
        ],
    ),
    *mutants_of(
        "services/light/sphere.py",
        "tests/test_sphere.py",
        [
            ("an azimuth of 2 pi", "np.where(phi >= 2 * np.pi, 0.0, phi)", "phi"),
            ("middle of a cell", "theta = (np.arange(rows) + 0.5) * (SPAN", "theta = np.arange(rows) * (SPAN"),
        ],
    ),
    *mutants_of(
        CAPTURE + "sequence.py",
        "tests/test_sequence.py",
        [
            (
                "order of numbers",
                "numbered = sorted(zip(numbers, paths, strict=True))",
                "numbered = list(zip(numbers, paths, strict=True))",
            ),
        ],
    ),
    *mutants_of(
        CAPTURE + "manifest.py",
        "tests/test_sequence.py tests/test_verify.py",
        [
            ("a half-written line of the manifest", 'or data.endswith(b"\\n")):', "or True):"),
            ("any line of the manifest", '(manifest.damaged_line <= data.count(b"\\n") or data.endswith(b"\\n"))', "False"),
            ("digests", "if hashlib.sha256(read_file(path, MAX_IMAGE_BYTES)).hexdigest() != sha256:", "if False:"),
            ("the last line", "RecordingEnd(frames=self._frames, files=files)", "RecordingEnd(frames=self._frames)"),
        ],
    ),
    *mutants_of(
        CAPTURE + "recorder.py",
        "tests/test_recorder.py",
        [
            (
                "an image that the manifest does not list",
                "            path.unlink(missing_ok=True)\n            raise",
                "            raise",
            ),
            ("queue doubled", "QUEUE_FRAMES = 8", "QUEUE_FRAMES = 16"),
            ("a recording overwritten", "if (folder / MANIFEST).exists():", "if False:"),
            ("queue halved", "QUEUE_FRAMES = 8", "QUEUE_FRAMES = 4"),
        ],
    ),
    *mutants_of(
        CAPTURE + "source.py",
        "tests/test_source.py tests/test_recorder.py",
        [
            ("time_s not divided by speed", "self._entries[k].time_s / self._speed", "self._entries[k].time_s"),
            ("fps not multiplied by speed", "self.fps = settings.fps * settings.speed", "self.fps = settings.fps"),
            ("rate of a header doubled", "MAX_FPS = 1000", "MAX_FPS = 2000"),
            ("files not checked", "if self._entries and k not in self._verified:", "if False:"),
            ("the last frame", "end = min(settings.end or len(files), len(files))", "end = len(files)"),
        ],
    ),
    *mutants_of(
        CAPTURE + "fisheye.py",
        "tests/test_fisheye.py tests/test_scatter.py tests/test_frames.py",
        [
            ("Bayer weights by the wrong lattice", "(n % 2, n // 2) for n in range(4)", "(n // 2, n % 2) for n in range(4)"),
            ("area of a green pixel", '"G": (2, 1)', '"G": (2, 2)'),
            ("end of a lit row", "lit.shape[1] - lit[:, ::-1].argmax(axis=1)", "lit.shape[1] - lit[:, ::-1].argmax(axis=1) - 1"),
            ("shape of a green pixel", '"G": (2, 1)', '"G": (1, 2)'),
        ],
    ),
    *mutants_of(
        CAPTURE + "frames.py",
        "tests/test_frames.py",
        [
            ("bright cells doubled", "BRIGHT_FRACTION = 1 / 500", "BRIGHT_FRACTION = 1 / 250"),
            ("bright cells halved", "BRIGHT_FRACTION = 1 / 500", "BRIGHT_FRACTION = 1 / 1000"),
            ("most bright cells doubled", "MAX_BRIGHT_CELLS = 64", "MAX_BRIGHT_CELLS = 128"),
            ("codes above the response", "> response.top:", "> 2 * response.top:"),
            ("bright cells of a mosaic by red", "self._fisheye[1 if len(self._fisheye) == 3 else 0]", "self._fisheye[0]"),
            ("clipped codes of red alone", "lit_runs(self._fisheye)", "lit_runs(self._fisheye[:1])"),
        ],
    ),
    *mutants_of(
        CAPTURE + "choosing.py",
        "tests/test_choosing.py",
        [
            ("the oldest recordings", "[-OFFERED:]", "[:OFFERED]"),
            ("a recording goes on without its source", "        self._recording.leave(self.current)\n", ""),
        ],
    ),
    *mutants_of(
        CAPTURE + "ground.py",
        "tests/test_ground.py",
        [
            ("irradiance of a sphere", "np.diff(edges * (2 - edges)) / 2", "np.diff(edges)"),
            ("suns in the middle of their cells", "total += (cosine", "total += 0 * (cosine"),
            ("radiosity for radiance", "albedo / np.pi *", "albedo *"),
        ],
    ),
    *mutants_of(
        CAPTURE + "masking.py",
        "tests/test_masking.py",
        [
            ("dark masks as a rim", "(dark.ravel()[neighbour] == 0)", "True"),
            ("lengths of edges", "edge[row + (down > 0)] * width / height", "1.0"),
            ("a leak that darkens", "LEAK = 1e-12", "LEAK = 1e-4"),
            ("distances across", "height / (middle[row] * width) if right", "1.0 if right"),
            ("samples of bright cells", "dark[cells], filled[cells] = ", "_, _ = "),
            ("weights of what is left", "share[left]", "bright.weights[left]"),
            ("nan around a fill", "np.where(np.isfinite(seen) & (seen > 0), seen, 0)", "seen"),
            ("a sun at the rim", "RIM_PEAK = 4.0", "RIM_PEAK = 4000.0"),
            ("a rim capped at its median", "RIM_PEAK = 4.0", "RIM_PEAK = 0.5"),
            ("cells by their middle", "SAMPLES = 3", "SAMPLES = 1"),
            ("a coarse raster", "RASTER_PIXELS = 2048", "RASTER_PIXELS = 64"),
            ("limit of a fill x 10", "MAX_FILLED_CELLS = 80_000", "MAX_FILLED_CELLS = 800_000"),
            ("the ground of before", "radiance = with_ground(radiance, bright, self._albedo)", "radiance = frame.radiance"),
        ],
    ),
    *mutants_of(
        "services/light/mask.py",
        "tests/test_masking.py tests/test_virtual_lamp.py",
        [
            ("points of all doubled", "MAX_POINTS = 512", "MAX_POINTS = 1024"),
            ("polygons of two", "MIN_POLYGON = 3", "MIN_POLYGON = 2"),
        ],
    ),
    *mutants_of(
        "services/light/virtual_lamp.py",
        "tests/test_virtual_lamp.py",
        [
            ("half the mean", "mean, square = (1 + cosine) / 2", "mean, square = np.ones_like(cosine)"),
            ("variance across", "across, along = (1 - square) / 2", "across, along = 1 - square"),
            ("ids of others", "VIRTUAL_IDS_FROM = 2**40", "VIRTUAL_IDS_FROM = 2**52"),
            ("one id twice", "if ids.count(each) > 1", "if ids.count(each) > 2"),
        ],
    ),
    *mutants_of(
        CAPTURE + "exposure_merge.py",
        "tests/test_brackets.py",
        [
            ("a channel alone", "if e == exposures - 1 or not clipped[e, y, x]:", "if True:"),
            (
                "weights of all exposures alike",
                "weight = np.square(exposures)[:, None] / relative",
                "weight = np.ones(len(exposures))[:, None] / relative",
            ),
            ("clipped codes count", "weight[:-1, values.clipped_from :] = 0", "weight[:-1, values.clipped_from :] *= 1"),
            ("rounding of times", "MAX_ROUNDING = 0.10", "MAX_ROUNDING = 0.01"),
            ("any time", "MAX_ROUNDING = 0.10", "MAX_ROUNDING = 9.0"),
            ("light below darkness", "light = response.radiance(np.arange", "light = 1.1 * response.radiance(np.arange"),
        ],
    ),
    *mutants_of(
        CAPTURE + "calibration/bracket_response.py",
        "tests/test_bracket_response.py",
        [
            ("exposures as written", "for exact in (False, True):", "for exact in (False,):"),
            ("any error", "MAX_ERROR = 0.05", "MAX_ERROR = 5.0"),
            ("a coarse polynomial", "DEGREE = 6", "DEGREE = 1"),
            ("clipped pixels", "BRIGHTEST = 10 / 255, 245 / 255", "BRIGHTEST = 10 / 255, 256 / 255"),
        ],
    ),
    *mutants_of(
        CAPTURE + "exposure_cycle.py",
        "tests/test_live_brackets.py",
        [
            ("delays of controls", "SETTLING = 8", "SETTLING = 4"),
            ("wide motion", "MOTION = 0.15", "MOTION = 5.0"),
            ("wide sigma", "np.log(sigma) + np.log1p", "np.log1p"),
        ],
    ),
    *mutants_of(
        CAPTURE + "strong_lights.py",
        "tests/test_live_brackets.py",
        [
            ("large windows", "if max(region.shape) <= REACH and", "if True and"),
            ("lights where they were", "across, down = (float(value) for", "across, down = (0 * float(value) for"),
            ("frames where they were", "window + by, 0, side - 1", "window, 0, side - 1"),
        ],
    ),
    *mutants_of(
        CAPTURE + "exposure_groups.py",
        "tests/test_brackets.py",
        [
            ("two exposures alike", "SAME = 1.05", "SAME = 1.02"),
            ("thirds of a stop", "SAME = 1.05", "SAME = 1.3"),
        ],
    ),
    *mutants_of(
        "services/light/exposure_tags.py",
        "tests/test_brackets.py",
        [
            ("aperture", "(self.f_number or 1.0) ** 2", "(self.f_number or 1.0)"),
            ("sensitivity", "self.time_s * self.iso / 100", "self.time_s"),
            ("longest time", "LONGEST_S, SHORTEST_S = 86_400.0", "LONGEST_S, SHORTEST_S = 1e9"),
        ],
    ),
    *mutants_of(
        CAPTURE + "polar.py",
        "tests/test_polar.py",
        [
            ("thin overlaps", "MIN_OVERLAP = 1e-9", "MIN_OVERLAP = 1e-16"),
            ("azimuth seam", "columns = (by_col.index - (width // 2) - 1) % width", "columns = (by_col.index - (width // 2)) % width"),
            ("thin overlaps ignored", "MIN_OVERLAP = 1e-9", "MIN_OVERLAP = 1e-5"),
        ],
    ),
    *mutants_of(
        CAPTURE + "response.py",
        "tests/test_response.py",
        [
            ("rounding of a code", "np.clip(np.rint(signal), 0, response.top)", "np.clip(np.floor(signal), 0, response.top)"),
            ("largest code", "return 2**self.bits - 1", "return 2**self.bits"),
            ("a log response without c", "response.c <= 0:", "response.c < 0:"),
            ("entries of the table", "np.arange(response.top + 1,", "np.arange(response.top,"),
        ],
    ),
    *mutants_of(
        CAPTURE + "simulation/motion.py",
        "tests/test_motion.py",
        [
            ("animation keys cut to the first", "if len(keys) == 1:", "if True:"),
            ("keys out of order", "after <= before", "after < before"),
            ("after the last key", "np.clip(time_s, times[0], times[-1])", "np.clip(time_s, times[0], times[-1] - 0.1)"),
        ],
    ),
    *mutants_of(
        CAPTURE + "lens.py",
        "tests/test_lens.py",
        [
            ("size doubled", "MAX_SIZE = 16384", "MAX_SIZE = 32768"),
            ("rotations twice as rough", "ROTATION_TOLERANCE = 1e-5", "ROTATION_TOLERANCE = 2e-5"),
            ("rotations twice as strict", "ROTATION_TOLERANCE = 1e-5", "ROTATION_TOLERANCE = 5e-6"),
            ("rim beyond the back", "0 < lens.rim_deg <= 180", "0 < lens.rim_deg <= 360"),
            ("slope beyond the rim", "7 * lens.k3", "5 * lens.k3"),
            ("derivative of the polynomial", "(3, 5, 7, 9)", "(3, 5, 7, 7)"),
            ("largest decentring", "MAX_DECENTRING = 0.5 ", "MAX_DECENTRING = 5.0 "),
            ("decentring beyond the rim", "m = (1 + lens.p3 * (u * u + v * v)) * beyond", "m = 1 + lens.p3 * (u * u + v * v)"),
            ("area of a decentred pixel", "ratio = ratio / ((1 + du_du)", "ratio = ratio * ((1 + du_du)"),
        ],
    ),
    *mutants_of(
        CAPTURE + "pixel_overlap.py",
        "tests/test_pixel_overlap.py tests/test_fisheye.py",
        [
            ("subpixels halved", "MIN_SUBPIXELS = 8", "MIN_SUBPIXELS = 4"),
            ("subpixels near the zenith", "SUBPIXELS_PER_CELL = 8", "SUBPIXELS_PER_CELL = 2"),
            ("subpixels on the zenith", "MAX_SUBPIXELS = 128", "MAX_SUBPIXELS = 16"),
            ("rounds of balancing", "BALANCING_ROUNDS = 40", "BALANCING_ROUNDS = 10"),
            (
                "azimuth seam",
                "(other - a[4] + 1.5 * grid.cols) % grid.cols - 0.5 * grid.cols",
                "other - a[4]",
                "pixels on the seam are then counted by subpixels, which is slower and as exact",
            ),
        ],
    ),
    *mutants_of(
        CAPTURE + "exr_header.py",
        "tests/test_exr_header.py",
        [
            ("length of a direction", "UNIT_TOLERANCE = 1e-4", "UNIT_TOLERANCE = 2.0"),
            ("scale to cd/m2", "MAX_LUMINANCE_SCALE = 1e30", "MAX_LUMINANCE_SCALE = 1e36"),
            ("number of samples doubled", "max_length=4096", "max_length=8192"),
            ("order of cells", "np.any(np.diff(cell) < 0)", "np.any(np.diff(cell) < -9)"),
        ],
    ),
    *mutants_of(
        CAPTURE + "v4l2.py",
        "tests/test_v4l2.py tests/test_v4l2_loss.py",
        [
            ("rate of a triggered camera", "DEFAULT_FPS = 25.0", "DEFAULT_FPS = 50.0"),
            ("numbers that go back", "lost >= 2**31", "lost >= 2**32"),
            ("large gaps", "lost >= 2**31", "lost >= 2**30"),
            ("the shallowest format", "return (-form.bits, form.mosaic", "return (form.bits, form.mosaic"),
            ("codes before pictures", "(bool(FORMATS[code].mosaic) == self._in_colour,", "("),
        ],
    ),
    *mutants_of(
        CAPTURE + "v4l2_colour.py",
        "tests/test_v4l2_colour.py",
        [
            ("default of the colorspace", "colorspace = colorspace or SRGB", "colorspace = colorspace or 3"),
            ("range of RGB", "if is_rgb or is_jpeg or", "if is_jpeg or"),
        ],
    ),
    *mutants_of(
        CAPTURE + "camera_controls.py",
        "tests/test_camera_controls.py",
        [
            ("unit of the exposure", "EXPOSURE_UNIT_S = 1e-4", "EXPOSURE_UNIT_S = 1e-3"),
            ("automatics first", "self._controls[row[0]].id in MANUAL", "self._controls[row[0]].id not in MANUAL"),
        ],
    ),
    *mutants_of(
        CAPTURE + "camera_source.py",
        "tests/test_v4l2_loss.py",
        [
            ("numbers of lost frames", "self._count += raw.lost + 1", "self._count += 1"),
        ],
    ),
    *mutants_of(
        "services/light/transfers.py",
        "tests/test_transfers.py",
        [
            ("peak of PQ", "PQ_PEAK = 10_000.0", "PQ_PEAK = 1000.0"),
            ("exposure index of LogC3", "0.247190, 0.385537", "0.256598, 0.391007"),
            ("gamma of HLG displays", "if 400 <= peak_cd_m2 <= 2000:", "if True:"),
        ],
    ),
    *mutants_of(
        "services/light/film_file.py",
        "tests/test_film_file.py",
        [
            ("cut films", "CUT_S = 0.5", "CUT_S = 50.0"),
            ("any key", "if self._index.is_key[n]", "if True"),
        ],
    ),
    *mutants_of(
        CAPTURE + "colour_coding.py",
        "tests/test_colour_coding.py",
        [
            ("a coarse table", "ENTRIES = 5121", "ENTRIES = 513"),
            ("video's range", 'ColourTags("bt709", "bt709", "bt709", "limited")', 'ColourTags("bt709", "bt709", "bt709", "full")'),
            ("tags over settings", "    if setting:\n        return setting, []\n", ""),
            ("any log's range", 'CODE_LOGS = ("slog3", "vlog")', 'CODE_LOGS = ("slog3", "vlog", "logc4")'),
        ],
    ),
    *mutants_of(
        CAPTURE + "colour_coding.py",
        "tests/test_planes.py",
        [
            ("half a step of white", "(1 - 0.5 / ", "(1 - 1.5 / "),
        ],
    ),
    *mutants_of(
        CAPTURE + "planes.py",
        "tests/test_planes.py",
        [
            ("gain of a display", ", none) ** exponent", ", none) ** 0"),
        ],
    ),
    *mutants_of(
        CAPTURE + "several_lenses.py",
        "tests/test_projections.py",
        [
            ("weights of the lens alone", "np.divide(seen[n], total, out", "np.divide(total, total, out"),
            ("circles on each other", "MOST_SHARED = 0.01", "MOST_SHARED = 1.01"),
            ("outside the image", "np.where(inside, np.clip", "np.where(inside | True, np.clip", "only for circles that the frame cuts"),
        ],
    ),
    *mutants_of(
        CAPTURE + "cube.py",
        "tests/test_projections.py",
        [
            ("solid angle of a pixel", "** -1.5", "** -1.0"),
            ("one part a pixel", "FEWEST_PARTS, MOST_PARTS = 4, 64", "FEWEST_PARTS, MOST_PARTS = 1, 1"),
        ],
    ),
    *mutants_of(
        CAPTURE + "scatter.py",
        "tests/test_scatter.py",
        [
            ("saturated codes", "row[x] >= top", "row[x] > top"),
            ("black codes", "row[x] == 0", "row[x] <= 1"),
        ],
    ),
    *mutants_of(
        CAPTURE + "stage.py",
        "tests/test_capture_stage.py",
        [
            ("stamps in the future", "max(0, stamp.monotonic_ns - frame.monotonic_ns)", "stamp.monotonic_ns - frame.monotonic_ns"),
        ],
    ),
    *mutants_of(
        CAPTURE + "mosaic_lights.py",
        "tests/test_mosaic_lights.py",
        [
            ("lights sharper than a mosaic", "SHARP_SHARE = 0.3", "SHARP_SHARE = 0.6"),
            ("blurred lights called sharp", "SHARP_SHARE = 0.3", "SHARP_SHARE = 0.15"),
        ],
    ),
    *mutants_of(
        CAPTURE + "invalid_cells.py",
        "tests/test_capture_stage.py tests/test_invalid_cells.py",
        [
            ("negative pixels", "(radiance >= 0)", "(radiance >= -1e9)"),
        ],
    ),
    *mutants_of(
        CAPTURE + "calibration/boards.py",
        "tests/test_lens_fit.py",
        [
            ("corners of a board doubled", "MIN_CORNERS, MAX_CORNERS = 3, 100", "MIN_CORNERS, MAX_CORNERS = 3, 200"),
            ("smallest square halved", "MIN_SQUARE_M, MAX_SQUARE_M = 1e-4, 100", "MIN_SQUARE_M, MAX_SQUARE_M = 5e-5, 100"),
            ("largest square doubled", "MIN_SQUARE_M, MAX_SQUARE_M = 1e-4, 100", "MIN_SQUARE_M, MAX_SQUARE_M = 1e-4, 200"),
        ],
    ),
    *mutants_of(
        CAPTURE + "calibration/lens_fit.py",
        "tests/test_lens_fit.py tests/test_lens_fit_models.py",
        [
            ("two views", "MIN_VIEWS = 3", "MIN_VIEWS = 2"),
            ("bad views by the median, doubled", "BAD_VIEW_MEDIANS = 2.5", "BAD_VIEW_MEDIANS = 5.0"),
            ("bad views by the median, halved", "BAD_VIEW_MEDIANS = 2.5", "BAD_VIEW_MEDIANS = 1.25"),
            ("bad views in pixels, doubled", "BAD_VIEW_PX = 0.5", "BAD_VIEW_PX = 1.0"),
            ("bad views in pixels, halved", "BAD_VIEW_PX = 0.5", "BAD_VIEW_PX = 0.25"),
            ("outliers, doubled", "OUTLIER_MEDIANS = 6.0", "OUTLIER_MEDIANS = 12.0"),
            ("outliers, halved", "OUTLIER_MEDIANS = 6.0", "OUTLIER_MEDIANS = 3.0"),
            ("gain of a term, doubled", "SIMPLER_FACTOR = 1.012", "SIMPLER_FACTOR = 1.024"),
            ("gain of a term, halved", "SIMPLER_FACTOR = 1.012", "SIMPLER_FACTOR = 1.006"),
            ("no robust loss", "FIRST_LOSS_PX, LOSS_PX = 10.0, 1.0", "FIRST_LOSS_PX, LOSS_PX = 10.0, 10.0"),
            ("narrow loss from the start", "FIRST_LOSS_PX, LOSS_PX = 10.0, 1.0", "FIRST_LOSS_PX, LOSS_PX = 1.0, 1.0", "1 to 40 do"),
            ("no prior", "PRIOR_TERM = 0.3", "PRIOR_TERM = 1e6", "it matters only where corners determine nothing"),
            ("no decentring", "for decentring in (0, 2):", "for decentring in (0, 0):", "the fit with p3 comes instead"),
            ("decentring where there is none", "for decentring in (0, 2):", "for decentring in (2,):"),
            ("deviations", "* _rms(fit.errors) ** 2 / 2", "* _rms(fit.errors) ** 2 * 50"),
        ],
    ),
    *mutants_of(
        CAPTURE + "calibration/lens_calibration.py",
        "tests/test_lens_fit.py",
        [
            ("a badly fitting lens", "MAX_RMS_FRACTION = 3e-3", "MAX_RMS_FRACTION = 60e-3"),
            ("edge of the image circle", "RIM_BRIGHTNESS = 1 / 3", "RIM_BRIGHTNESS = 1 / 4", "0.2 to 0.5 do"),
        ],
    ),
    *mutants_of(
        CAPTURE + "calibration/response_fit.py",
        "tests/test_response_fit.py",
        [
            ("error of a check patch, doubled", "MAX_CHECK_ERROR = 0.05", "MAX_CHECK_ERROR = 0.10"),
            ("error of a check patch, halved", "MAX_CHECK_ERROR = 0.05", "MAX_CHECK_ERROR = 0.025"),
            ("bits without a word", '; --bits says otherwise")\n', '; --bits says otherwise") if False else None\n'),
            ("fitted patches that are off", "if not abs(error) <= MAX_CHECK_ERROR and abs(off) > CODE_TOLERANCE:", "if False:"),
            ("patches of a log response", '"log": 4', '"log": 3'),
            ("clipped patches", "0 < p.code < 2**bits - 1", "0 <= p.code <= 2**bits - 1"),
            ("patches that verify", "CHECK_PATCHES = (1, 4)", "CHECK_PATCHES = (0, 5)"),
        ],
    ),
    *mutants_of(
        CAPTURE + "calibration/response_outliers.py",
        "tests/test_response_fit.py",
        [
            ("codes that fall", "CODE_TOLERANCE = 2.0", "CODE_TOLERANCE = 200.0"),
            ("outliers", "OUTLIER_RATIO = 5.0", "OUTLIER_RATIO = 500.0"),
            ("outliers everywhere", "OUTLIER_RATIO = 5.0", "OUTLIER_RATIO = 0.5"),
            ("most patches outliers", "MAX_OUTLIERS = 0.25", "MAX_OUTLIERS = 0.75"),
        ],
    ),
    *mutants_of(
        CAPTURE + "calibration/colorchecker.py",
        "tests/test_colorchecker.py",
        [
            ("patches that must be found", "MIN_PATCHES = 14", "MIN_PATCHES = 22"),
            ("order of lightness", "MIN_RANK_CORRELATION = 0.6", "MIN_RANK_CORRELATION = 0.4", "0.4 to 0.8 do"),
        ],
    ),
    *mutants_of(
        CAPTURE + "simulation/simulate.py",
        "tests/test_sensor.py tests/test_virtual_camera.py",
        [
            ("depth of flicker", "FLICKER_DEPTH = 0.3", "FLICKER_DEPTH = 0.2"),
            ("rotation a frame", "lighting.rotate_deg_per_frame * camera.fps", "lighting.rotate_deg_per_frame"),
        ],
    ),
    *mutants_of(
        CAPTURE + "simulation/sensor.py",
        "tests/test_sensor.py",
        [
            ("largest half float", "MAX_HALF = 65504.0", "MAX_HALF = 32752.0"),
            ("frames that are lost", ">= camera.dropouts", "< camera.dropouts"),
        ],
    ),
    *mutants_of(
        CAPTURE + "simulation/optics.py",
        "tests/test_virtual_camera.py tests/test_recipe.py",
        [
            ("light that is scattered", "BRIGHT = 16.0", "BRIGHT = 1e9"),
            ("rays of a pixel", "RAYS = 4 ", "RAYS = 1 "),
            ("light near the rim", "BEYOND_RIM = 1.05", "BEYOND_RIM = 0.9"),
        ],
    ),
    *mutants_of(
        "services/plate/video_source.py",
        "tests/test_plate.py",
        [
            ("side of a picture", "> MAX_SIDE", "> 2 * MAX_SIDE"),
            ("bytes of a picture", "> wire.MAX_PART", "> 2 * wire.MAX_PART"),
            ("a video's frame rate", "0 < self.fps <= MAX_FPS", "0 <= self.fps"),
        ],
    ),
]
