"""Mutants of real fixtures."""

from tests.mutants.mutant import mutants_of

PACKAGE = "services/fixtures/"
T = "tests/test_fixtures_"

MUTANTS = [
    *mutants_of(PACKAGE + "irradiance_kernel.py", f"{T}levels.py", [
        ("no shadows in the kernel", "OCCLUDED = 0.3", "OCCLUDED = 0.0"),
        ("wide lights as points", "    if variance <= POINT_VARIANCE:", "    if True:"),
        ("a covariance's cross terms", "+ 2.0 * across", "+ across"),
    ]),
    *mutants_of(PACKAGE + "photometrics.py", f"{T}rig.py", [
        ("beams at a quarter", "(2 * angle_deg / beam_deg) ** 2", "(4 * angle_deg / beam_deg) ** 2"),
        ("panels of one piece", "MIN_PIECES, MAX_PIECES = 3, 8", "MIN_PIECES, MAX_PIECES = 1, 1"),
        ("light that falls off once", "return directions, candela / distances**2", "return directions, candela / distances"),
    ]),
    *mutants_of(PACKAGE + "rig.py", f"{T}rig.py", [
        ("colours beyond the spectrum", "if not (y > 0 and x >= 0 and x + y <= 1):", "if not (y > 0):"),
        ("fixtures in the head", "MIN_DISTANCE_M = 0.1", "MIN_DISTANCE_M = 0.01"),
        ("slots past the universe", "if slot >= UNIVERSE_SLOTS:", "if slot > UNIVERSE_SLOTS:"),
        ("slots of two owners", "!= fixture.name:", "== 0:"),
        ("emitters doubled", "MAX_EMITTERS = 2048", "MAX_EMITTERS = 4096"),
    ]),
    *mutants_of(PACKAGE + "rig_system.py", f"{T}levels.py", [
        ("metamers drift", "METAMER_RIDGE = 3e-3", "METAMER_RIDGE = 0.0"),
        ("luminance traded for colour", "    return 3 * np.outer(LUMINANCE_WEIGHTS, LUMINANCE_WEIGHTS) +", "    return np.eye(3) +"),
    ]),
    *mutants_of(PACKAGE + "solver.py", f"{T}levels.py", [
        ("numbers tremble", "KEPT_STEPS = 0.55", "KEPT_STEPS = 0.5"),
        ("one at a time", "if best_i != 0:", "if False:"),
        ("few sweeps", "MAX_SWEEPS = 400", "MAX_SWEEPS = 4"),
        ("rounded and left so", "    for _ in range(MAX_SWEEPS):\n        _single", "    for _ in range(0):\n        _single"),
    ]),
    *mutants_of(PACKAGE + "levels.py", f"{T}levels.py", [
        ("a gain that pumps", "return state.gain, -math.inf", "return AUTO_LEVEL / max(float(target.max()), 1e-9), -math.inf"),
        ("no hysteresis below", "OFF, ON = 0.5, 0.75", "OFF, ON = 0.75, 0.75"),
        ("power unlimited", "        if float(watts[member] @ levels[member]) > group.watts * (1 + 1e-9):", "        if False:"),
        ("rounded above the power", "        while rest < 0 and", "        while False and"),
        ("a delay of two", "/ 1e3 / elapsed_s", "/ 5e2 / elapsed_s"),
    ]),
    *mutants_of(PACKAGE + "transmission.py", f"{T}sending.py", [
        ("live before it is armed", '(packets.PREVIEW if "preview" in sent.mode else 0)', "0"),
        ("Art-Net before it is armed", '(protocol != "sacn" and mode != "live")', "False"),
        ("rare packets at once", "EQUAL_PACKETS = 3", "EQUAL_PACKETS = 1"),
        ("packets too rare", "KEEP_ALIVE_S = 0.85", "KEEP_ALIVE_S = 1.2"),
        ("no word of the end", '(packets.TERMINATED if "ending" in sent.mode else 0)', "0"),
        ("no sync", "if len(sent.look) > 1 else 0", "if False else 0"),
        ("sequences from 0 again", "start = int(now_s * rig.output.rate_hz)", "start = 0"),
    ]),
    *mutants_of(PACKAGE + "sender.py", f"{T}sending.py", [
        ("dark at the end", 'if self._sent.mode == "live" and self._blackout_at_end:', 'if self._sent.mode == "live":'),
        ("looks that jump", "if look is None or self._rig.between == \"hold\" or", "if True or"),
    ]),
    *mutants_of(PACKAGE + "sender.py", f"{T}service.py", [
        ("an end before the restart", "if self._is_abandoned or self._sent", "if self._sent"),
    ]),
    *mutants_of(PACKAGE + "packed_xml.py", f"{T}mvr.py", [
        ("a DOCTYPE", "            if XML_BOMB.search(text):", "            if False:"),
        ("deep elements", "        if depth > MAX_DEPTH:", "        if False:"),
        ("members without end", "        if self._left < 0:", "        if False:", "the size that the archive states is looked at before"),
        ("large members", ".file_size > self._left:", ".file_size > 2**40:"),
    ]),
    *mutants_of(PACKAGE + "mvr.py", f"{T}mvr.py", [
        ("millimetres", "MM = 1e-3", "MM = 1e-2"),
        ("groups that do not turn", "matrix[:3] @ parent[:3], matrix[3:]", "matrix[:3], matrix[3:]"),
        ("shining upwards", "matrix[3] - AIM_M", "matrix[3] + AIM_M"),
    ]),
    *mutants_of(PACKAGE + "measuring.py", f"{T}measuring.py", [
        ("without the dark picture", "lit.radiance - dark.radiance", "lit.radiance"),
        ("clipped light", "if clipped := max(each.saturated for each in seen) - dark.saturated:", "if clipped := 0:"),
    ]),
    *mutants_of("services/viewer/viewer_state.py", f"{T}page.py", [
        ("anybody arms", "        if control.armed and self.why_not_arm:", "        if False:"),
    ]),
]  # fmt: skip
