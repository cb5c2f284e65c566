"""Mutants of files, messages, sockets and processes."""

from tests.mutants.mutant import mutants_of

RUNTIME = "services/runtime/"

MUTANTS = [
    *mutants_of("services/files.py", "tests/test_files.py", [
        ("length of a TOML file doubled", "MAX_TOML_BYTES = 2**20", "MAX_TOML_BYTES = 2**21"),
        ("devices read as files", "if not stat.S_ISREG(status.st_mode):", "if False:"),
        ("half-written files", "        part.unlink(missing_ok=True)\n", "        pass\n"),
    ]),
    *mutants_of("services/toml.py", "tests/test_toml.py tests/test_files.py", [
        ("parts of a key doubled", "MAX_KEY_DOTS = 32", "MAX_KEY_DOTS = 64"),
        ("a byte order mark", ".removeprefix(codecs.BOM_UTF8)", ""),
        ("nan and inf", "not math.isfinite(data)", "False"),
        ("the line after", "return without + 1 if lines else 0", "return without + 2 if lines else 0"),
        ("a line at any price", "len(text) < MAX_PARSED // 4", "True"),
        ("no suggestion", "near = get_close_matches(key, here, 1)", "near = []"),
        ("the nearest key before the right section", "if key in _fields(_plain(field))]", "if False]"),
    ]),
    *mutants_of("services/journal.py", "tests/test_journal.py", [
        ("a chain of each line alone", "hashlib.sha256(before.encode() + content)", "hashlib.sha256(content)"),
        ("somebody else's file emptied", 'if end == JOURNAL_START and b"\\n" in rest:', "if False:"),
        ("damage that cannot be mended", "if lines > 1 and not can_be_made_again:", "if False:"),
        ("lines in memory alone", "            os.fsync(descriptor)\n        except", "        except"),
        ("half a line left", "                os.ftruncate(descriptor, self.end.offset)\n            raise",
         "                pass\n            raise"),
        ("two writers", "LOCK_EX | fcntl.LOCK_NB)", "LOCK_SH | fcntl.LOCK_NB)"),
        ("a writer that was just killed", "DYING_S = 1.0", "DYING_S = 0.0", "waiting for it is needed on a busy machine alone"),
        ("a point of another file", "== point.chain.encode() if point.offset", "!= b\"\" if point.offset"),
    ]),
    *mutants_of("services/settings.py", "tests/test_settings.py", [
        ("relative video paths", '`out`; empty: none"), PATH]', '`out`; empty: none")]'),
        ("relative paths", "elif value and PATH in get_args(hint):", "elif False:"),
    ]),
    *mutants_of(RUNTIME + "transport.py", "tests/test_transport.py", [
        ("socket folder's permissions", "found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o077",
         "found.st_uid != os.getuid() or stat.S_IMODE(found.st_mode) & 0o007"),
        ("key file's permissions", "secret.stat().st_mode) & 0o077", "secret.stat().st_mode) & 0o007"),
        ("mode of a new folder", "mode=0o700, parents=True, exist_ok=True)\n        found", "parents=True, exist_ok=True)\n        found"),
        ("length of a socket's path", "MAX_SOCKET_PATH = 107", "MAX_SOCKET_PATH = 108"),
        ("largest part accepted", "socket.maxmsgsize = wire.MAX_PART", "socket.maxmsgsize = -1"),
        ("queue of a socket", "socket.sndhwm = socket.rcvhwm = queue", "socket.sndhwm = socket.rcvhwm = 1000"),
        ("handshake", "HANDSHAKE_MS = 2000", "HANDSHAKE_MS = 30000"),
        ("probes of a silent host doubled", "KEEPALIVE_S, KEEPALIVE_PROBES = 1, 3", "KEEPALIVE_S, KEEPALIVE_PROBES = 1, 6"),
        ("probes of a silent host halved", "KEEPALIVE_S, KEEPALIVE_PROBES = 1, 3", "KEEPALIVE_S, KEEPALIVE_PROBES = 1, 1"),
        ("time between probes doubled", "KEEPALIVE_S, KEEPALIVE_PROBES = 1, 3", "KEEPALIVE_S, KEEPALIVE_PROBES = 2, 3"),
        ("subscriptions to unknown topics", "if topic in _TOPICS:", "if True:"),
        ("secret key's mode", "os.umask(0o077)", "os.umask(0o022)"),
        ("a second process at a socket", "fcntl.LOCK_EX | fcntl.LOCK_NB", "fcntl.LOCK_SH | fcntl.LOCK_NB"),
        ("ports of a service", "2 * SERVICES.index(service)", "1 * SERVICES.index(service)"),
    ]),
    *mutants_of(RUNTIME + "wire.py", "tests/test_wire.py", [
        ("nan in half-float arrays", 'if dtype in ("<f2", "<f4") and', 'if dtype in ("<f4",) and'),
        ("header doubled", "MAX_HEADER = 64 * 1024", "MAX_HEADER = 128 * 1024"),
        ("part doubled", "MAX_PART = 64 * 1024 * 1024", "MAX_PART = 128 * 1024 * 1024"),
        ("poses doubled", "MAX_POSES = 128", "MAX_POSES = 256"),
        ("unit vectors doubled", "UNIT = 1e-3", "UNIT = 4e-3"),
        ("unit vectors halved", "UNIT = 1e-3", "UNIT = 2.5e-4"),
        ("negative irradiance", "or (irradiance < 0).any():", "or False:"),
        ("bright cells out of order", "(np.diff(cells) >= 0).all() and", "True and"),
        ("weight of a bright cell", "& (weights <= 1)", ""),
        ("bright cells beyond the map", "cells < self.rows * self.cols", "cells <= self.rows * self.cols"),
        ("topic of another kind", "if bytes(parts[0]) != header.kind.encode():", "if False:"),
        ("versions", "if version != VERSION:", "if version > VERSION:"),
    ]),
    *mutants_of(RUNTIME + "demand.py", "tests/test_demand.py", [
        ("`extends`: a request that extends another", "header.first == open_request.until", "header.first <= open_request.until"),
        ("`extends`: forgotten", "open_request.first if open_request and extends else header.first", "header.first"),
        ("consumers doubled", "MAX_CONSUMERS = 64", "MAX_CONSUMERS = 128"),
        ("window doubled", "WINDOW_FRAMES = 4", "WINDOW_FRAMES = 8"),
        ("requested again later", "RETRY_S = 1.0", "RETRY_S = 10.0"),
        ("the end of the stream", "if end is not None and first >= end:", "if end is not None and first > end:"),
    ]),
    *mutants_of(RUNTIME + "sync.py", "tests/test_sync.py", [
        ("last frames", "LAST_FRAMES = 16", "LAST_FRAMES = 1"),
        ("clocks of two machines", "same_clock = stamp.boot_id and stamp.boot_id == header.stamp.boot_id", "same_clock = True"),
    ]),
    *mutants_of(RUNTIME + "service_stats.py", "tests/test_service_stats.py", [
        ("rate over a longer time", "RATE_WINDOW_S = 2.0", "RATE_WINDOW_S = 20.0"),
        ("a producer that starts again", "or frames < self._first + self._received:", "or False:"),
        ("dropped frames", "frames - self._first - self._received", "frames - self._first"),
        ("lines about refused messages", "REFUSED_LINE_S = 60.0", "REFUSED_LINE_S = 10.0"),
        ("control characters of a sender", 'ascii(str(error))[1:-1][:300]', 'str(error)'),
        ("intervals of a rate", "return (len(recent) - 1) /", "return len(recent) /"),
    ]),
    *mutants_of(RUNTIME + "token.py", "tests/test_viewer_authentication.py", [
        ("token halved", "TOKEN_BYTES = 24", "TOKEN_BYTES = 12"),
        ("loopback", "return ipaddress.ip_address(host).is_loopback", "return ipaddress.ip_address(host).is_private"),
    ]),
    *mutants_of(RUNTIME + "supervise.py", "tests/test_supervise.py::test_a_service_is_restarted_at_once_and_then_later_and_later "
                "tests/test_supervise.py::test_five_deaths_within_a_minute_are_too_many", [
        ("delay of a restart", "len(RESTART_DELAY_S)) - 1]", "len(RESTART_DELAY_S)) - 2]"),
        ("deaths before giving up doubled", "MAX_DEATHS = 5", "MAX_DEATHS = 10"),
        ("deaths before giving up halved", "MAX_DEATHS = 5", "MAX_DEATHS = 3"),
        ("time of deaths doubled", "GIVE_UP_S = 60.0", "GIVE_UP_S = 120.0"),
        ("time of deaths halved", "GIVE_UP_S = 60.0", "GIVE_UP_S = 30.0"),
    ]),
    *mutants_of(RUNTIME + "loop.py", "tests/test_live_input.py", [
        ("stale doubled", "STALE_MS = 60", "STALE_MS = 120"),
        ("stale halved", "STALE_MS = 60", "STALE_MS = 30"),
        ("frames passed over are not counted", "self._stats.skipped += newest is not None", "pass"),
        ("the end forgotten", "newest, self.end = (header, arrays), None", "newest = (header, arrays)"),
    ]),
]
