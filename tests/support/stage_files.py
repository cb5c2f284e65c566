"""Small MVR and GDTF files, made by hand from the standards' tables."""

import io
import zipfile

EMITTERS = """
<Emitter Name="Red" Color="0.69,0.308,24"/><Emitter Name="Green" Color="0.19,0.72,66"/><Emitter Name="Blue" Color="0.14,0.05,10"/>
"""


def channel(offset: str, attribute: str, emitter: str = "", default: str = "0/1", highlight: str = "None") -> str:
    named = f' Emitter="{emitter}"' if emitter else ""
    return (
        f'<DMXChannel DMXBreak="1" Offset="{offset}" Geometry="Body" Highlight="{highlight}"><LogicalChannel Attribute="{attribute}">'
        f'<ChannelFunction Name="f" Attribute="{attribute}" Default="{default}"{named}/></LogicalChannel></DMXChannel>'
    )


MODES = {
    "Standard": [
        channel("1", "Dimmer"), channel("2,3", "ColorAdd_R", "Emitters.Red"), channel("4,5", "ColorAdd_G", "Emitters.Green"),
        channel("6,7", "ColorAdd_B", "Blue"), channel("8", "Shutter1", default="30/1", highlight="255/1"),
        channel("9", "Macro", default="12/1"),
    ],
    "Moving": [channel("1,2", "Pan", default="32768/2"), channel("3", "Tilt"), channel("5", "ColorAdd_R"), channel("4", "ColorAdd_W")],
    "White": [channel("1", "Dimmer")],
    "Nothing": [channel("1", "Pan")],
}  # fmt: skip


def gdtf(head: str = "", flux: float = 8000.0, beam_deg: float = 20.0) -> bytes:
    """A fixture of MODES. head: before the root element."""
    modes = "".join(f'<DMXMode Name="{name}"><DMXChannels>{"".join(made)}</DMXChannels></DMXMode>' for name, made in MODES.items())
    geometry = f'<Geometry Name="Body"><Beam Name="Beam" LuminousFlux="{flux}" BeamAngle="{beam_deg}" FieldAngle="30"/></Geometry>'
    text = (
        f'<?xml version="1.0" encoding="UTF-8"?>{head}<GDTF DataVersion="1.2"><FixtureType Name="Lamp" FixtureTypeID="0">'
        f"<PhysicalDescriptions><Emitters>{EMITTERS}</Emitters></PhysicalDescriptions><Geometries>{geometry}</Geometries>"
        f"<DMXModes>{modes}</DMXModes></FixtureType></GDTF>"
    )
    return packed({"description.xml": text.encode()})


def fixture(name: str, matrix: str, address: str, mode: str = "Standard", focus: str = "") -> str:
    return (
        f'<Fixture name="{name}" uuid="u-{name}"><Matrix>{matrix}</Matrix><GDTFSpec>Lamp.gdtf</GDTFSpec><GDTFMode>{mode}</GDTFMode>'
        f'<Focus>{focus}</Focus><Addresses><Address break="0">{address}</Address></Addresses></Fixture>'
    )


HANGING = "{1,0,0}{0,1,0}{0,0,1}"  # shines down
TOWARDS_X = "{0,0,1}{0,1,0}{-1,0,0}"  # its -z is +x
FOCUS = f'<FocusPoint name="target" uuid="f1"><Matrix>{HANGING}{{0,0,1600}}</Matrix></FocusPoint>'
FIXTURES = (
    fixture("key", HANGING + "{2000,1000,4000}", "513"),
    f'<GroupObject name="truss" uuid="g"><Matrix>{{0,1,0}}{{-1,0,0}}{{0,0,1}}{{0,0,3000}}</Matrix><ChildList>'
    f'{fixture("fill", TOWARDS_X + "{-3000,0,0}", "1.100")}</ChildList></GroupObject>',
    fixture("head", HANGING + "{0,3000,4000}", "30", "Moving", "f1"),
)


def mvr(*children: str, head: str = "", lamp: bytes | None = None) -> bytes:
    scene = (
        f'<?xml version="1.0" encoding="UTF-8"?>{head}<GeneralSceneDescription verMajor="1" verMinor="6"><Scene><Layers>'
        f'<Layer name="l" uuid="l"><ChildList>{"".join(children)}</ChildList></Layer></Layers></Scene></GeneralSceneDescription>'
    )
    return packed({"GeneralSceneDescription.xml": scene.encode(), "Lamp.gdtf": gdtf() if lamp is None else lamp})


def packed(members: dict[str, bytes]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return file.getvalue()
