"""Mutants of the sampler."""

from tests.mutants.mutant import mutants_of

SAMPLER = "services/sampler/"
TRACKED = "tests/test_tracked_decisions.py tests/test_tracked.py"

MUTANTS = [
    *mutants_of("services/sampler/snapshot.py", "tests/test_sampler_snapshot.py", [
        ("a snapshot after the frame", "if snapshot.frames <= target), None)", "if snapshot.frames <= target + 16), None)"),
        ("only the newest", "*(kept for kept in self._newest[-1:] if", "*(kept for kept in self._newest[:0] if"),
        ("damage", "if hashlib.sha256(content).digest() != digest:", "if False:"),
        ("any type of number", "if header.dtype not in DTYPES:", "if False:"),
    ]),
    *mutants_of(SAMPLER + "cluster.py", "tests/test_cluster.py", [
        ("lights stay longer", "STAY = 1.15", "STAY = 2.3"),
        ("lights do not stay", "STAY = 1.15", "STAY = 1.0"),
        ("fill halved", "FILL = 0.85", "FILL = 0.425"),
        ("smallest angle doubled", "np.radians(1.0)", "np.radians(4.0)"),
    ]),
    *mutants_of(SAMPLER + "light_count.py", "tests/test_light_count.py", [
        ("hold doubled", "HOLD_S = 1.0", "HOLD_S = 2.0"),
        ("hold halved", "HOLD_S = 1.0", "HOLD_S = 0.5"),
        ("retry back-off doubled", "RETRY_BACKOFF_S = 60.0", "RETRY_BACKOFF_S = 120.0"),
        ("retry back-off halved", "RETRY_BACKOFF_S = 60.0", "RETRY_BACKOFF_S = 30.0"),
        ("hysteresis of the number", "WELL_BELOW = 0.8", "WELL_BELOW = 1.0"),
        ("hysteresis of the number halved", "WELL_BELOW = 0.8", "WELL_BELOW = 0.4"),
        ("fade doubled", "FADE_S = 0.2", "FADE_S = 0.4"),
    ]),
    *mutants_of(SAMPLER + "required_lights.py", "tests/test_required_lights.py", [
        ("margin of the error aimed at to 1", "ERROR_MARGIN = 0.85", "ERROR_MARGIN = 1.0"),
        ("margin of the error aimed at halved", "ERROR_MARGIN = 0.85", "ERROR_MARGIN = 0.425"),
        ("dark probes doubled", "DARK_PROBE = 0.05", "DARK_PROBE = 0.1"),
        ("dark probes halved", "DARK_PROBE = 0.05", "DARK_PROBE = 0.025"),
        ("hot cells as blocks", "HOT_CELL = 1 / 512", "HOT_CELL = 1 / 2"),
        ("steps an octave", "LADDER_START, LADDER_STEPS = 4, 4", "LADDER_START, LADDER_STEPS = 4, 2"),
    ]),
    *mutants_of(SAMPLER + "light_map.py", "tests/test_light_map.py", [
        ("largest radiance", "MAX_RADIANCE = 1e30", "MAX_RADIANCE = 1e38"),
    ]),
    *mutants_of(SAMPLER + "temporal/filter.py", "tests/test_filter.py", [
        ("dark frames x 100", "DARK_FRAME = 1e-3", "DARK_FRAME = 1e-1"),
        ("dark frames / 100", "DARK_FRAME = 1e-3", "DARK_FRAME = 1e-5"),
        ("frames of the rate", "RATE_FRAMES = 9", "RATE_FRAMES = 3"),
        ("time constant", "np.sqrt(np.sqrt(2.0) - 1)", "np.sqrt(2.0)"),
    ]),
    *mutants_of(SAMPLER + "temporal/flicker.py", "tests/test_flicker.py", [
        ("frames of the fit halved", "\nFIT_FRAMES = 64", "\nFIT_FRAMES = 32"),
        ("frames before a fit doubled", "MIN_FIT_FRAMES = 24", "MIN_FIT_FRAMES = 48"),
        ("frames before a fit halved", "MIN_FIT_FRAMES = 24", "MIN_FIT_FRAMES = 12"),
        ("flicker depth doubled", "MIN_DEPTH = 3e-3", "MIN_DEPTH = 6e-3"),
        ("flicker depth halved", "MIN_DEPTH = 3e-3", "MIN_DEPTH = 1.5e-3"),
        ("flicker hysteresis", "DETECTED, LOST = 0.6, 0.4", "DETECTED, LOST = 0.6, 0.6"),
        ("flicker detected at once", "DETECTED, LOST = 0.6, 0.4", "DETECTED, LOST = 0.4, 0.4"),
        ("flicker never lost", "DETECTED, LOST = 0.6, 0.4", "DETECTED, LOST = 0.6, 0.0"),
        ("black frames", "BLACK_FRAME = 1e-3", "BLACK_FRAME = 1e-8"),
        ("slowest beat doubled", "SLOWEST_BEAT_HZ = 1.0", "SLOWEST_BEAT_HZ = 4.0"),
        ("blocks corrected", "CORRECT_FULLY, CORRECT_NOT = 0.6, 0.3", "CORRECT_FULLY, CORRECT_NOT = 0.06, 0.03"),
        ("lamps of 60 Hz mains", "LAMPS_HZ = (100.0, 120.0)", "LAMPS_HZ = (100.0, 100.0)"),
    ]),
    *mutants_of(SAMPLER + "tracking/cleaning.py", TRACKED + " tests/test_tracked_tiles.py", [
        ("inpainted frames doubled", "INPAINT_FRAMES = 2", "INPAINT_FRAMES = 4"),
        ("inpainted frames halved", "INPAINT_FRAMES = 2", "INPAINT_FRAMES = 1"),
        ("noise at once", "CLEAR_SIGMAS = 3.0", "CLEAR_SIGMAS = 0.5"),
        ("least gain doubled", "MIN_GAIN = np.float32(0.12)", "MIN_GAIN = np.float32(0.24)"),
    ]),
    *mutants_of(SAMPLER + "tracking/noise.py", TRACKED + " tests/test_tracked_tiles.py", [
        ("mean of the noise", "MEAN_GAIN = 0.2", "MEAN_GAIN = 0.8"),
        ("changes of the scene", "MAX_CHANGE = np.float32(0.3)", "MAX_CHANGE = np.float32(3.0)"),
    ]),
    *mutants_of(SAMPLER + "tracking/split_merge.py", "tests/test_tracked_split_merge.py tests/test_tracked_decisions.py", [
        ("gain over cost", "GAIN_OVER_COST = 2.0", "GAIN_OVER_COST = 20.0"),
        ("gain over mean", "GAIN_OVER_MEAN = 0.5", "GAIN_OVER_MEAN = 50.0"),
        ("two-means", "TWO_MEANS_STEPS = 4", "TWO_MEANS_STEPS = 1"),
        ("all exchanges are urgent", "URGENT = 0.02", "URGENT = 0.002"),
        ("no exchange is urgent", "URGENT = 0.02", "URGENT = 2.0"),
        ("exchanges of a frame", "MAX_EXCHANGES = 6", "MAX_EXCHANGES = 12"),
    ]),
    *mutants_of(SAMPLER + "tracking/sources.py", "tests/test_sources.py", [
        ("power to enter", "ENTER_POWER, STAY_POWER = 0.03, 0.01", "ENTER_POWER, STAY_POWER = 0.015, 0.01"),
        ("power to stay", "ENTER_POWER, STAY_POWER = 0.03, 0.01", "ENTER_POWER, STAY_POWER = 0.03, 0.02"),
        ("reach of a match", "MATCH_RAD = np.radians(12.0)", "MATCH_RAD = np.radians(24.0)"),
        ("matches that are near only", "MATCH_RAD = np.radians(12.0)", "MATCH_RAD = np.radians(6.0)"),
        ("waiting doubled", "WAIT_S = 1.0", "WAIT_S = 2.0"),
        ("waiting halved", "WAIT_S = 1.0", "WAIT_S = 0.5"),
        ("a wide light's edge", "while reached < 0.75 * area:", "while reached < 0.3 * area:"),
        ("what a source leaves", "_is_apart(made.directions[:count], centre):", "True:"),
        ("a halo in its source", "CORE_SPREADS = 2.0", "CORE_SPREADS = 20.0"),
        ("a source without its edge", "CORE_SPREADS = 2.0", "CORE_SPREADS = 0.5"),
        ("forgotten over a gap", "| (before.seen_s >= before.seen_s.max(initial=-np.inf))", ""),
        ("light behind a source", "above = 1 - behind / radiance[t]", "above = 1.0"),
        ("faintest sources", "[:max_count]", ""),
    ]),
    *mutants_of(SAMPLER + "tracking/extents.py", "tests/test_extents.py", [
        ("no steps", "STEPS = 3", "STEPS = 0"),
        ("hard weights", "SHARPNESS = np.float32(3.0)", "SHARPNESS = np.float32(0.5)"),
        ("no extent of a tile", "return 0.5 * max(1 - tiles", "return 0.0 * max(1 - tiles"),
        ("one site near", "NEIGHBOURS = 16", "NEIGHBOURS = 1"),
    ]),
    *mutants_of(SAMPLER + "tracking/tracked.py", TRACKED + " tests/test_tracked_required_lights.py", [
        ("scene change doubled", "\nSCENE_CHANGE = 2.0", "\nSCENE_CHANGE = 4.0"),
        ("scene change halved", "\nSCENE_CHANGE = 2.0", "\nSCENE_CHANGE = 1.0"),
        ("period of exchanges doubled", "EXCHANGE_PERIOD = 8", "EXCHANGE_PERIOD = 16"),
        ("period of exchanges halved", "EXCHANGE_PERIOD = 8", "EXCHANGE_PERIOD = 4"),
        ("running mean doubled", "MEAN_GAIN = 0.2", "MEAN_GAIN = 0.4"),
        ("running mean halved", "MEAN_GAIN = 0.2", "MEAN_GAIN = 0.1"),
        ("birth of a light doubled", "BIRTH_TIME_S = 0.12", "BIRTH_TIME_S = 0.24"),
        ("birth of a light halved", "BIRTH_TIME_S = 0.12", "BIRTH_TIME_S = 0.06"),
        ("growth in a frame", "MAX_GROWTH = 4", "MAX_GROWTH = 2"),
        ("no several first sites", "MIN_MEAN_DIRECTION = 0.1", "MIN_MEAN_DIRECTION = 0.0"),
        ("error aimed at", "ERROR_AIM = 0.77", "ERROR_AIM = 1.2"),
        ("rise at once", "MAX_RISE = 2.0", "MAX_RISE = 8.0"),
        ("no Lloyd updates", "if first or len(sites.ids) == before:", "if first:"),
    ]),
    *mutants_of(SAMPLER + "tracking/voronoi.py", TRACKED + " tests/test_tracked_tiles.py", [
        ("rounding of chords below 1", "np.float32(1.00001)", "np.float32(0.9)"),
        ("opposite directions", "MIN_LENGTH = 0.1", "MIN_LENGTH = 0.0"),
    ]),
    *mutants_of(SAMPLER + "tracking/tiles.py", "tests/test_tracked_tiles.py tests/test_tracked_decisions.py", [
        ("light of a tile doubled", "TILE_FRACTION = 0.25", "TILE_FRACTION = 0.5"),
        ("Lloyd weights", "WEIGHT_EXPONENT = 1.6", "WEIGHT_EXPONENT = 1.0"),
    ]),
]
