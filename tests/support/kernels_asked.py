"""Which kernels a piece of Python asks numba for: `python -m tests.support.kernels_asked STATEMENTS ARGUMENT...` prints them as JSON.

Each is a function with the types of its arguments: what is not in numba's cache then is compiled.
"""

import json
import sys
from typing import Any

from numba.core import caching


def main() -> None:
    asked, load = set(), caching.Cache.load_overload

    def noted(cache: Any, signature: object, context: object) -> Any:
        asked.add(f"{cache._py_func.__module__}.{cache._py_func.__qualname__} {signature}")
        return load(cache, signature, context)

    caching.Cache.load_overload = noted  # pyright: ignore[reportAttributeAccessIssue]
    statements = sys.argv[1]
    sys.argv = sys.argv[1:]
    exec(statements, {"__name__": "statements"})
    print(json.dumps(sorted(asked)))


if __name__ == "__main__":
    main()
