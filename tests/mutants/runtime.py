"""Mutants of files, messages, sockets and processes."""

from tests.mutants.mutant import mutants_of

RUNTIME = "services/runtime/"

MUTANTS = [
    *mutants_of(
        "services/files.py",
        "tests/test_files.py",
        [
            ("length of a TOML file doubled", "MAX_TOML_BYTES = 2**20", "MAX_TOML_BYTES = 2**21"),
            ("devices read as files", "if not stat.S_ISREG(status.st_mode):", "if False:"),
            ("addresses opened", "if ADDRESS.match(reference):", "if False:"),
            ("upwards out of the folder", 'or ".." in Path(reference).parts', ""),
            ("links out of the folder", "    if not inside:", "    if False:"),
            ("half-written files", "        part.unlink(missing_ok=True)\n", "        pass\n"),
        ],
    ),
    *mutants_of(
        "services/toml.py",
        "tests/test_toml.py tests/test_files.py",
        [
            ("parts of a key doubled", "MAX_KEY_DOTS = 32", "MAX_KEY_DOTS = 64"),
            ("a byte order mark", ".removeprefix(codecs.BOM_UTF8)", ""),
            ("nan and inf", "not math.isfinite(data)", "False"),
            ("the line after", "return without + 1 if lines else 0", "return without + 2 if lines else 0"),
            ("a line at any price", "if parsed > MAX_PARSED:", "if False:"),
            ("no suggestion", "near = get_close_matches(key, here, 1)", "near = []"),
            ("the nearest key before the right section", "if key in _fields(_plain(field))]", "if False]"),
        ],
    ),
    *mutants_of(
        "services/journal.py",
        "tests/test_journal.py",
        [
            ("a chain of each line alone", "hashlib.sha256(before.encode() + content)", "hashlib.sha256(content)"),
            ("somebody else's file emptied", 'if end == JOURNAL_START and b"\\n" in rest:', "if False:"),
            ("damage that cannot be mended", "if lines > 1 and not can_be_made_again:", "if False:"),
            ("lines in memory alone", "            os.fsync(descriptor)\n        except", "        except"),
            (
                "half a line left",
                "                os.ftruncate(descriptor, self.end.offset)\n            raise",
                "                pass\n            raise",
            ),
            ("two writers", "flock(descriptor, how |", "flock(descriptor, fcntl.LOCK_SH |"),
            ("a writer that was just killed", "DYING_S = 1.0", "DYING_S = 0.0", "waiting for it is needed on a busy machine alone"),
            ("a point of another file", "== point.chain.encode() if point.offset", '!= b"" if point.offset'),
        ],
    ),
    *mutants_of(
        "services/settings.py",
        "tests/test_settings.py",
        [
            ("relative video paths", '`out`; empty: none"), PATH]', '`out`; empty: none")]'),
        ],
    ),
    *mutants_of(
        "services/settings_file.py",
        "tests/test_settings.py",
        [
            ("relative paths", "elif value and PATH in get_args(hint):", "elif False:"),
        ],
    ),
    *mutants_of(
        RUNTIME + "transport.py",
        "tests/test_transport.py",
        [
            (
                "socket folder's permissions",
                "found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o077",
                "found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o007",
            ),
            ("key file's permissions", "secret.stat().st_mode) & 0o077", "secret.stat().st_mode) & 0o007"),
            (
                "mode of a new folder",
                "mode=0o700, parents=True, exist_ok=True)\n        found",
                "parents=True, exist_ok=True)\n        found",
            ),
            ("length of a socket's path", "MAX_SOCKET_PATH = 107", "MAX_SOCKET_PATH = 108"),
            ("largest part accepted", "socket.maxmsgsize = max_part", "socket.maxmsgsize = -1"),
            ("largest part of a request", "MAX_ASKED = 1024", "MAX_ASKED = 2048"),
            ("peers that take nothing", "TAKES_NOTHING_MS = 10_000", "TAKES_NOTHING_MS = 100_000"),
            ("queue of a socket", "socket.sndhwm = socket.rcvhwm = queue", "socket.sndhwm = socket.rcvhwm = 1000"),
            ("handshake", "HANDSHAKE_MS = 2000", "HANDSHAKE_MS = 30000"),
            ("probes of a silent host doubled", "KEEPALIVE_S, KEEPALIVE_PROBES = 1, 3", "KEEPALIVE_S, KEEPALIVE_PROBES = 1, 6"),
            ("probes of a silent host halved", "KEEPALIVE_S, KEEPALIVE_PROBES = 1, 3", "KEEPALIVE_S, KEEPALIVE_PROBES = 1, 1"),
            ("time between probes doubled", "KEEPALIVE_S, KEEPALIVE_PROBES = 1, 3", "KEEPALIVE_S, KEEPALIVE_PROBES = 2, 3"),
            ("time of an attempt to connect", "CONNECT_MS = 50, 200, 650", "CONNECT_MS = 50, 200, 1300"),
            ("subscriptions to unknown topics", "if topic not in _TOPICS:", "if False:"),
            ("secret key's mode", "os.umask(0o077)", "os.umask(0o022)"),
            ("a second process at a socket", "fcntl.LOCK_EX | fcntl.LOCK_NB", "fcntl.LOCK_SH | fcntl.LOCK_NB"),
        ],
    ),
    *mutants_of(
        RUNTIME + "wire_names.py",
        "tests/test_transport.py tests/test_instances.py",
        [
            ("ports of a service", "2 * SERVICES.index(service_of(name))", "1 * SERVICES.index(service_of(name))"),
            ("second port of a service", "for port in (first, first + 1) if first", "for port in (first,) if first"),
            ("ports of different hosts", "taken.get((host, port))", "taken.get((LOOPBACK, port))"),
            ("the page's port", "(other := taken.get(page))", "(other := None)"),
            ("keys of the other transport", "if getattr(wire, key) != getattr(unset, key):", "if False:"),
        ],
    ),
    *mutants_of(
        RUNTIME + "wire.py",
        "tests/test_wire.py",
        [
            ("nan in half-float arrays", 'if dtype in ("<f2", "<f4") and', 'if dtype in ("<f4",) and'),
            ("header doubled", "MAX_HEADER = 64 * 1024", "MAX_HEADER = 128 * 1024"),
            ("part doubled", "MAX_PART = 64 * 1024 * 1024", "MAX_PART = 128 * 1024 * 1024"),
            ("unit vectors doubled", "UNIT = 1e-3", "UNIT = 4e-3"),
            ("unit vectors halved", "UNIT = 1e-3", "UNIT = 2.5e-4"),
            ("negative irradiance", "or (irradiance < 0).any():", "or False:"),
            ("bright cells out of order", "(np.diff(cells) >= 0).all() and", "True and"),
            ("weight of a bright cell", "& (weights <= 1)", ""),
            ("bright cells beyond the map", "cells < self.rows * self.cols", "cells <= self.rows * self.cols"),
            ("topic of another kind", "if bytes(parts[0]) != header.kind.encode():", "if False:"),
            ("versions", "if version != VERSION:", "if version > VERSION:"),
        ],
    ),
    *mutants_of(
        RUNTIME + "poses.py",
        "tests/test_wire.py",
        [
            ("poses doubled", "MAX_POSES = 128", "MAX_POSES = 256"),
        ],
    ),
    *mutants_of(
        RUNTIME + "peers.py",
        "tests/test_peers.py",
        [
            ("a tcp peer past its limit only shut down", "if connection.family == network.AF_UNIX:", "if True:"),
            ("unreadable messages without end", "REFUSED_BURST, REFUSED_PER_S = 32, 0.5", "REFUSED_BURST, REFUSED_PER_S = 32, 500"),
            ("subscriptions without end", "SUBSCRIPTIONS_PER_S = 64, 8", "SUBSCRIPTIONS_PER_S = 64, 8000"),
            ("many parts", "        if sender:\n            sender.offence", "        if False:\n            sender.offence"),
            ("parts kept", "if count <= wire.MAX_PARTS + 1:", "if True:"),
        ],
    ),
    *mutants_of(
        RUNTIME + "peer_guard.py",
        "tests/test_peers.py",
        [
            ("unfinished bytes of tcp", "received - peer.mark > limit or", "False or"),
            ("whole messages", "            peer.took, peer.mark = False, received\n", "            peer.took = False\n"),
            ("one peer too many", "if monitor.accepts and len(came) > limit:", "if False:"),
            ("a held address", "self._held_until_s.get(peer.name, 0.0) > peer.since_s", "False"),
            ("an address held for ever", "time.monotonic() + HOLD_S", "time.monotonic() + 1e9"),
        ],
    ),
    *mutants_of(
        RUNTIME + "log_lines.py",
        "tests/test_log_lines.py",
        [
            ("lines of a kind", "LINE_PERIOD_S = 60.0", "LINE_PERIOD_S = 10.0"),
            ("control characters of a sender", "ascii(line)[1:-1][:400]", "line"),
        ],
    ),
    *mutants_of(
        RUNTIME + "open_files.py",
        "tests/test_open_files.py",
        [
            ("all files for peers", "- OWN_FILES) // 3", "- OWN_FILES) // 1"),
            ("the limit as it was", "(hard, hard)", "(file_limit(), hard)"),
        ],
    ),
    *mutants_of(
        RUNTIME + "demand.py",
        "tests/test_demand.py",
        [
            ("`extends`: a request that extends another", "header.first == open_request.until", "header.first <= open_request.until"),
            ("`extends`: forgotten", "open_request.first if open_request and extends else header.first", "header.first"),
            ("consumers doubled", "MAX_CONSUMERS = 64", "MAX_CONSUMERS = 128"),
            ("consumers that take nothing", "STALLED_S = 2.0", "STALLED_S = 20.0"),
            ("room for a new consumer", "        del self._requests[longest]\n", "        raise ValueError\n"),
            ("frames packed once", "if known is not message:", "if True:"),
            ("window doubled", "WINDOW_FRAMES = 4", "WINDOW_FRAMES = 8"),
            ("requested again later", "RETRY_S = 1.0", "RETRY_S = 10.0"),
            ("the end of the stream", "if end is not None and first >= end:", "if end is not None and first > end:"),
        ],
    ),
    *mutants_of(
        RUNTIME + "sync.py",
        "tests/test_sync.py",
        [
            ("last frames", "LAST_FRAMES = 16", "LAST_FRAMES = 1"),
            ("clocks of two machines", "same_clock = stamp.boot_id and stamp.boot_id == header.stamp.boot_id", "same_clock = True"),
        ],
    ),
    *mutants_of(
        RUNTIME + "service_stats.py",
        "tests/test_service_stats.py",
        [
            ("rate over a longer time", "RATE_WINDOW_S = 2.0", "RATE_WINDOW_S = 20.0"),
            ("a producer that starts again", "or frames < self._first + self._received:", "or False:"),
            ("dropped frames", "frames - self._first - self._received", "frames - self._first"),
            ("a disk that refuses now and then", "and time.monotonic() - self._unwritten_line_s > LINE_PERIOD_S:", "and True:"),
            ("intervals of a rate", "return (len(recent) - 1) /", "return len(recent) /"),
        ],
    ),
    *mutants_of(
        RUNTIME + "token.py",
        "tests/test_viewer_authentication.py",
        [
            ("token halved", "TOKEN_BYTES = 24", "TOKEN_BYTES = 12"),
            ("loopback", "return ipaddress.ip_address(host).is_loopback", "return ipaddress.ip_address(host).is_private"),
        ],
    ),
    *mutants_of(
        RUNTIME + "restarts.py",
        "tests/test_supervise.py::test_a_service_that_dies_of_starting_is_restarted_later_and_later "
        "tests/test_supervise.py::test_a_service_that_worked_is_restarted_at_once "
        "tests/test_supervise.py::test_five_deaths_within_a_minute_are_too_many",
        [
            ("delay of a restart", "min(self._soon, len(RESTART_DELAY_S) - 1)", "min(self._soon, len(RESTART_DELAY_S) - 2)"),
            ("a start that takes long", "SOON_S = 5.0", "SOON_S = 2.5"),
            ("soon after a start doubled", "SOON_S = 5.0", "SOON_S = 10.5"),
            ("deaths before giving up doubled", "MAX_DEATHS = 5", "MAX_DEATHS = 10"),
            ("deaths before giving up halved", "MAX_DEATHS = 5", "MAX_DEATHS = 3"),
            ("time of deaths doubled", "GIVE_UP_S = 60.0", "GIVE_UP_S = 120.0"),
            ("time of deaths halved", "GIVE_UP_S = 60.0", "GIVE_UP_S = 30.0"),
        ],
    ),
    *mutants_of(
        RUNTIME + "spare.py",
        "tests/test_spare.py",
        [
            ("a command line longer than its place", "[: end - start - 1]", ""),
            ("a spare without a supervisor", "if not line:", "if False:"),
            ("code that is not loaded", "prepare(settings)\n", "pass\n"),
        ],
    ),
    *mutants_of(
        RUNTIME + "output_folder.py",
        "tests/test_output_folder.py tests/test_image_sequence.py",
        [
            ("pictures of another version of the settings", "if before[key] != value:", "if False:"),
            ("another source", "if found.inputs.get(key) != wanted.inputs[key]]", "if False]"),
            ("pictures read again", "NEWEST = 64", "NEWEST = 0"),
            ("pictures that are gone", "if not {picture.name, png} <= present:", "if False:"),
            ("a live run continued", "if not lossless and (pictures or lights.count):", "if False:"),
            ("files beside the pictures", "if whole < len(self.pictures) or not self._others_whole():", "if whole < len(self.pictures):"),
            ("somebody else's pictures", "    if strangers:", "    if False:"),
        ],
    ),
    *mutants_of(
        RUNTIME + "run_inputs.py",
        "tests/test_output_folder.py",
        [
            ("times of files", "{status.st_size}\\0{status.st_mtime_ns}", "{status.st_size}"),
            ("what a scene names", "            waiting += [file.parent / name for name in _names(file)]\n", ""),
        ],
    ),
    *mutants_of(
        RUNTIME + "interrupt.py",
        "tests/test_interrupt.py",
        [
            ("raised while OpenGL draws", "if not self._deferred:", "if True:"),
            ("forgotten", "        self.came = True\n", ""),
            ("pressed twice", "        if self.came:\n            os._exit(INTERRUPTED)\n", ""),
        ],
    ),
    *mutants_of(
        RUNTIME + "loop.py",
        "tests/test_live_input.py",
        [
            ("stale doubled", "STALE_MS = 60", "STALE_MS = 120"),
            ("stale halved", "STALE_MS = 60", "STALE_MS = 30"),
            ("frames passed over are not counted", "self._stats.skipped += newest is not None", "pass"),
            ("the end forgotten", "newest, self.end = (header, arrays), None", "newest = (header, arrays)"),
        ],
    ),
]
