"""The JSON Schema of all headers, which proto/wire.schema.json holds."""

import inspect

import msgspec

from vemlight.runtime.wire import KINDS, VERSION, AnyHeader


def schema() -> dict:
    """The headers' JSON Schema, as exported to proto/wire.schema.json; `x-arrays` describes the arrays that follow a header."""
    (kinds,), definitions = msgspec.json.schema_components([AnyHeader], ref_template="#/$defs/{name}")
    for definition in definitions.values():
        definition["description"] = inspect.cleandoc(definition["description"])
    for kind in KINDS.values():
        definition = definitions[kind.__name__]
        definition["required"].insert(0, "version")  # has a default so that `pack` can fill it in; on the wire it must be there
        definition["x-arrays"] = [array._asdict() for array in kind.ARRAYS]
    draft = "https://json-schema.org/draft/2020-12/schema"
    return {"$schema": draft, "title": f"vemlight wire {VERSION}", **kinds, "$defs": definitions}
