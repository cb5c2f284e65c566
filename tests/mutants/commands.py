"""Mutants of the command line, its self-test and the settings."""

from tests.mutants.mutant import mutants_of

COMMANDS = "services/commands/"

MUTANTS = [
    *mutants_of("services/commands/machine_settings.py", "tests/test_machine_settings.py", [
        ("rates that swing hold", "if fit.departure <= HOLDS:", "if True:"),
        ("any rate keeps up", "KEEPS_UP = 0.75", "KEEPS_UP = 0.1"),
        ("few lights are enough", "ENOUGH_LIGHTS = 20", "ENOUGH_LIGHTS = 10"),
        ("larger pictures without a GPU", "if side <= 1 or on_gpu:", "if True:"),
        ("files that exist", "if path.exists():", "if False:"),
        ("a trial is recorded", 'record="", recordings=""', 'recordings=""'),
    ]),
    *mutants_of(COMMANDS + "locate.py", "tests/test_locate.py", [
        ("frames of other moments", "> 0.5 / fps + 1e-6:", "> 50 / fps:"),
        ("a still has no near lights", "        if count == 1:\n", "        if False:\n"),
        ("all cameras count alike", "FuseState.start(rig, options.subject)", "FuseState.start(rig)"),
    ]),
    *mutants_of("services/setting_keys.py", "tests/test_settings.py", [
        ("pictures x 100", "MAX_PICTURE_SIDE = 8192", "MAX_PICTURE_SIDE = 819200"),
        ("lights x 10", "Count = Annotated[int, Meta(ge=1, le=100_000)]", "Count = Annotated[int, Meta(ge=1, le=1_000_000)]"),
        ("no lights", "Count = Annotated[int, Meta(ge=1, le=100_000)]", "Count = Annotated[int, Meta(ge=0, le=100_000)]"),
        ("frames beyond the rate", "Rate = Annotated[float, Meta(gt=0, le=1000)]", "Rate = Annotated[float, Meta(ge=0, le=1000)]"),
        ("ports beyond TCP's", "Meta(ge=1, le=65_000)", "Meta(ge=1, le=65_535)"),
    ]),
    *mutants_of("services/settings.py", "tests/test_settings.py", [
        ("default lights", "FIXED_COUNT = 72", "FIXED_COUNT = 144"),
        ("default error", "ADAPTIVE_PERCENT = 5.0", "ADAPTIVE_PERCENT = 10.0"),
        ("default maximum", "ADAPTIVE_COUNT = 256", "ADAPTIVE_COUNT = 512"),
        ("a limit beside a number", "if self.is_soft and self.count is None else 0.0", "if self.is_soft else 0.0"),
        ("any filter with any method", '(self.method == "tracked") != (self.filter == "adaptive")', "False"),
        ("a token without one", "if self.token and self.insecure:", "if False:"),
        ("video paths stay", 'requires `out`; empty: none"), PATH]', 'requires `out`; empty: none")]'),
    ]),
    *mutants_of("services/settings_file.py", "tests/test_settings.py", [
        ("tcp without keys", 'and not settings.wire.keys and not settings.wire.insecure', "and False"),
        ("a camera in lossless mode", 'if settings.mode == "lossless" and is_live(source):', "if False:"),
        ("relative paths stay", 'return str(folder / value) if is_path(value) else value', "return value"),
        ("options as in Python", "key.replace('_', '-')", "key"),
    ]),
    *mutants_of("services/source_names.py", "tests/test_settings.py", [
        ("files in memory are cameras", ' and not source.startswith("/dev/shm/")', ""),
        ("passwords are printed", "{host.rpartition('@')[2]}", "{host}"),
    ]),
    *mutants_of(COMMANDS + "doctor.py", "tests/test_doctor.py", [
        ("libzmq's floor", "MIN_LIBZMQ = (4, 3, 5)", "MIN_LIBZMQ = (4, 3, 4)"),
        ("free disk / 10", "MIN_FREE_BYTES = 2**30", "MIN_FREE_BYTES = 2**27"),
        ("free disk x 10", "MIN_FREE_BYTES = 2**30", "MIN_FREE_BYTES = 2**33"),
        ("memory / 10", "MIN_MEMORY_BYTES = 2**30", "MIN_MEMORY_BYTES = 2**27"),
        ("memory x 10", "MIN_MEMORY_BYTES = 2**30", "MIN_MEMORY_BYTES = 2**33"),
        ("one core is enough", "if cores < 2:", "if cores < 1:"),
        ("two cores are too few", "if cores < 2:", "if cores < 3:"),
        ("old libraries pass", "if _numbers(version) < _numbers(floor):", "if False:"),
        ("versions of one number", "version.split(\".\")[:3]", "version.split(\".\")[:1]"),
    ]),
    *mutants_of(COMMANDS + "offline.py", "tests/test_offline.py", [
        ("rows of a sphere", '180 if options.coverage == "sphere"', '90 if options.coverage == "sphere"'),
        ("a single map filtered", 'None if frames > 1 else "none"', "None"),
    ]),
    *mutants_of(COMMANDS + "rendering.py", "tests/test_offline.py", [
        ("regions of a hemisphere", '0 if options.coverage == "hemisphere" and not options.ground else None', "None"),
        ("pictures without pixels", "1 <= side <= MAX_PICTURE_SIDE", "side <= settings.MAX_PICTURE_SIDE"),
    ]),
    *mutants_of(COMMANDS + "archive/folder.py", "tests/test_archive.py", [
        ("states of other plans", "state.plan == self.plan_digest and ", ""),
        ("lights that were changed", "if not self._holds(k, digest)), None)", "if False), None)"),
        ("frames that were changed", "if files(k) != digest), None)", "if False), None)"),
        ("two archives in one folder", "fcntl.LOCK_SH if shared else fcntl.LOCK_EX", "fcntl.LOCK_SH"),
        ("makers of maps one by one", "fcntl.LOCK_SH if shared else fcntl.LOCK_EX", "fcntl.LOCK_EX"),
        ("one state", "STATES = 2", "STATES = 1"),
        ("maps stay", "        self.maps(chunk).unlink(missing_ok=True)\n\n    def complete", "\n    def complete"),
    ]),
    *mutants_of(COMMANDS + "archive/plan.py", "tests/test_archive.py", [
        ("any options", "if before.get(key) != now.get(key):", "if False:"),
        ("defaults left out", "msgspec.structs.asdict(section)", "section", "matters when a default changes"),
    ]),
    *mutants_of(COMMANDS + "archive/chunks.py", "tests/test_archive.py", [
        ("sizes of a chunk's own", "                source.frame(0)", "                pass"),
    ]),
    *mutants_of(COMMANDS + "archive/workers.py", "tests/test_archive.py", [
        ("four deaths", "MAX_DEATHS = 3", "MAX_DEATHS = 4"),
        ("killed while it loads", "if not (worker.is_ready or worker.was_killed):", "if not worker.is_ready:"),
        ("chunks of the dead are lost", "        waiting.extendleft(reversed(worker.given))", "        pass"),
    ]),
    *mutants_of(COMMANDS + "archive/map_file.py", "tests/test_map_file.py", [
        ("damage passes", "            if found != check:", "            if False:"),
        ("cells outside", "((bright[0] >= 0) & (bright[0] < cells)).all()", "True"),
        ("what follows passes", "        if self._left:", "        if False:"),
        ("memory before it is there", "if 12 * cells + 24 * head.samples > self._left:", "if False:"),
    ]),
    *mutants_of("services/fuse/bundle_adjustment.py", "tests/test_bundle_adjustment.py", [
        ("fewer places", "MIN_PLACES = 12", "MIN_PLACES = 11"),
        ("places close together", "MIN_ANGLE_RAD = math.radians(20.0)", "MIN_ANGLE_RAD = math.radians(2.0)"),
        ("bearings that do not fit", "MAX_RESIDUAL_RAD = math.radians(0.2)", "MAX_RESIDUAL_RAD = math.radians(2.0)"),
        ("nothing left out", "        used = kept\n    return", "    return"),
        ("no start of the bearings' own", "    if (found := relative_poses(bearings, seen, start)) is not None:", "    if False:"),
        ("steps of the place the other way", "np.concatenate([by_turn, -by_place], axis=2)",
         "np.concatenate([by_turn, by_place], axis=2)"),
    ]),
    *mutants_of("services/fuse/board_poses.py", "tests/test_board_poses.py", [
        ("two moments are enough", "MIN_MOMENTS = 3", "MIN_MOMENTS = 2"),
        ("no board is upside down", "ways = (other, _upside_down(other)) if other.whole and one.whole else (other,)", "ways = (other,)"),
        ("boards that do not fit", "if fit.residual_rad > MAX_RESIDUAL_RAD:", "if False:"),
        ("deviations x 2", "both = np.sqrt(", "both = 2 * np.sqrt("),
        ("by the first camera alone", "for known in placed for own in", "for known in (0,) for own in"),
        ("turns the other way", "turn = Rotation.from_matrix([pose.turn for pose in agreeing]).mean()", "turn = Rotation.identity()"),
    ]),
    *mutants_of("services/fuse/tracks.py", "tests/test_locating.py", [
        ("a dimmed lamp is another", "noise[:, 3, 3] += DIMMED_LN_FLUX**2", "pass"),
        ("a lamp returns as another", "np.where(away < limit, 4 -", "np.where(away < -1, 4 -"),
        ("a lamp returns anywhere", "np.where(away < limit, 4 - away / limit", "np.where(away < 1e9, 4"),
        ("errors of poses are averaged", "(self.noise + self.fixed)[:, :3, :3]", "self.noise[:, :3, :3]"),
    ]),
    *mutants_of("services/fuse/triangulation.py", "tests/test_locating.py", [
        ("poses without an error of place", "place = pose[1] * rho / length", "place = 0.0"),
    ]),
    *mutants_of("services/fuse/fusing.py", "tests/test_fusing.py", [
        ("poses that are wrong", "trust is None or trust > 0", "True"),
        ("saturated pixels", "SATURATED_SIGMA, FLUX_SIGMA)", "FLUX_SIGMA, FLUX_SIGMA)"),
        ("light counted twice", "        if source >= 0:\n", "        if False:\n"),
        ("a still's noise is averaged", "state._replace(gains=known.gains, hits=1)", "known._replace(hits=1)"),
        ("sources beyond the limit are not said", "        if each and each.beyond\n", "        if False\n"),
    ]),
    *mutants_of("services/fuse/trust.py", "tests/test_fusing.py", [
        ("a hidden lamp speaks against poses", "UNEXPLAINED = 0.3", "UNEXPLAINED = 5.0"),
    ]),
    *mutants_of("services/fuse/compact_sources.py", "tests/test_fusing.py", [
        ("glow on a wall turns a bearing", "BRIGHT = 0.1", "BRIGHT = 0.0"),
    ]),
    *mutants_of("services/fuse/moments.py", "tests/test_fuse_moments.py", [
        ("the period of a slow camera", "SILENT_FRAMES * self._period_ns(camera)", "SILENT_FRAMES * self.period_ns"),
        ("a pause taken for a period", "SLOWEST_NS = 2_000_000_000", "SLOWEST_NS = 200_000_000_000"),
        ("the first camera sets the beat", "ALIKE = 1.5", "ALIKE = 150"),
        ("a slow camera is waited for", "self._period_ns(k) - early_ns > seen.at_ns + half_ns", "self._period_ns(k) - early_ns > math.inf"),
    ]),
    *mutants_of("services/fuse/gains.py", "tests/test_fuse_return.py", [
        ("a camera that comes back in another unit", "frames[gone] = -1", "frames[gone] = 0"),
        ("the reference after its return", "np.minimum(frames, MEMORY)", "0 * np.minimum(frames, MEMORY)"),
    ]),
    *mutants_of("services/fuse/wand.py", "tests/test_bundle_adjustment.py", [
        ("lamps of the room", "0, frame.strength)", "frame.strength, frame.strength)"),
        ("single frames beside held places", "held if held.shape[1] >= MIN_STILL else bearings", "bearings"),
        ("places of one camera", ".sum(axis=0) >= 2]", ".sum(axis=0) >= 1]"),
    ]),
    *mutants_of(COMMANDS + "archive/index.py", "tests/test_archive_index.py", [
        ("no number of indices", "    if options.indices is None:", "    if False:"),
    ]),
    *mutants_of(COMMANDS + "parameters.py", "tests/test_cli.py", [
        ("six numbers of four points", "if len(numbers) != 8 or", "if len(numbers) < 6 or"),
        ("digits of a size", " and len(number) < 6", ""),
    ]),
    *mutants_of(COMMANDS + "parameters.py", "tests/test_wrong_inputs.py", [
        ("nan among the options", "if not math.isfinite(number):", "if False:"),
        ("any suffix", "if path.suffix.lower() not in self._suffixes:", "if False:"),
        ("folders for files", "if path.is_dir():\n            self.fail(", "if False:\n            self.fail("),
        ("files for folders", "if not nearest.is_dir():", "if False:"),
        ("nan among the corners", "or not all(map(math.isfinite, numbers))", ""),
        ("no near option", "did you mean {' or '.join(near)}?", "see its help"),
    ]),
    *mutants_of(COMMANDS + "run_checks.py", "tests/test_wrong_inputs.py", [
        ("half characters", '    checked_utf8(settings, "a settings file")', "    pass"),
        ("any source", "        open_files(capture).check()\n", "        pass\n"),
        ("sources by their names only", "open_files(capture).check()", "open_files(capture)"),
        ("any scene", "    if settings.renderer.scene:", "    if False:"),
        ("any plate", "    elif plate.source:", "    elif False:"),
        ("devices are cameras", "os.major(status.st_rdev) == MEMORY_DEVICES", "False"),
        ("any video", "    if settings.renderer.video:", "    if False:"),
        ("a lens that is not named", "    for name in capture.lenses:\n        with _named(", "    for name in ():\n        with _named("),
    ]),
    *mutants_of(COMMANDS + "report.py", "tests/test_cli.py tests/test_wrong_inputs.py", [
        ("quiet prints", "elif not quiet:", "else:"),
        ("a line among the lights", "err=to_standard_output", "err=False"),
        ("JSON among the lights", "if as_json and (quiet or to_standard_output):", "if as_json and quiet:"),
    ]),
    *mutants_of(COMMANDS + "cli.py", "tests/test_cli.py", [
        ("status of a user's mistake", "context.exit(2)\n        except FatalError", "context.exit(0)\n        except FatalError"),
        ("status of a failure", "context.exit(1)", "context.exit(0)"),
    ]),
    *mutants_of("services/files.py", "tests/test_files.py", [
        ("half a file left", "part.unlink(missing_ok=True)", "pass"),
        ("a file that never gets its name", "        os.replace(part, path)\n", "        pass\n"),
    ]),
]  # fmt: skip
