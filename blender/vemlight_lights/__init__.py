"""Blender extension: suns that follow the light of a running vemlight. Panel "vemlight" in the 3D view's sidebar."""

import time

import bpy

from .feed import Feed, is_this_machine
from .suns import Suns

PERIOD_S = 1 / 60  # between two looks for a frame
PANEL_PERIOD_S = 0.5  # between two redrawings of the panel


class Preferences(bpy.types.AddonPreferences):
    bl_idname = __package__

    address: bpy.props.StringProperty(name="Viewer", default="http://127.0.0.1:8080", description="Address of vemlight's viewer")
    token: bpy.props.StringProperty(name="Token", subtype="PASSWORD", description="The viewer's token, where it has one")
    strength: bpy.props.FloatProperty(name="Strength", default=1.0, min=0.0, soft_max=100.0, description="Factor of all suns")

    def draw(self, _):
        for name in ("address", "token", "strength"):
            self.layout.prop(self, name)


class Connection:
    """The one connection of this Blender."""

    feed: Feed | None = None
    suns: Suns | None = None
    count = 0
    drawn_s = 0.0


def preferences():
    return bpy.context.preferences.addons[__package__].preferences


def step():
    """Called by Blender's timer: shows the newest frame. The time to the next call; None when it is the last."""
    if Connection.feed is None:
        return None
    if frame := Connection.feed.take():
        try:
            Connection.suns = Connection.suns or Suns(bpy, bpy.context.scene)
            Connection.count = Connection.suns.show(frame, preferences().strength)
        except ReferenceError:  # another file was loaded, or an object was deleted: found anew with the next frame
            Connection.suns = None
    if time.monotonic() - Connection.drawn_s > PANEL_PERIOD_S:
        Connection.drawn_s = time.monotonic()
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "VIEW_3D":
                    area.tag_redraw()
    return PERIOD_S


def end():
    if Connection.feed:
        Connection.feed.end()
    Connection.feed = Connection.suns = None
    Connection.count = 0


class Connect(bpy.types.Operator):
    bl_idname = "vemlight.connect"
    bl_label = "Connect"
    bl_description = "Let the scene's suns follow vemlight's lights"

    def execute(self, _):
        chosen = preferences()
        if not (is_this_machine(chosen.address) or bpy.app.online_access):
            self.report({"ERROR"}, "Another machine needs Preferences, System, Allow Online Access")
            return {"CANCELLED"}
        end()
        Connection.feed = Feed(chosen.address, chosen.token)
        if not bpy.app.timers.is_registered(step):
            bpy.app.timers.register(step, persistent=True)
        return {"FINISHED"}


class Disconnect(bpy.types.Operator):
    bl_idname = "vemlight.disconnect"
    bl_label = "Disconnect"
    bl_description = "Leave the suns as they are"

    def execute(self, _):
        end()
        return {"FINISHED"}


class Panel(bpy.types.Panel):
    bl_idname = "VIEW3D_PT_vemlight"
    bl_label = "vemlight"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "vemlight"

    def draw(self, _):
        chosen, layout = preferences(), self.layout
        for name in ("address", "token", "strength"):
            layout.prop(chosen, name)
        if Connection.feed is None:
            layout.operator(Connect.bl_idname)
        else:
            layout.operator(Disconnect.bl_idname)
            layout.label(text=Connection.feed.state)
            layout.label(text=f"{Connection.count} lights")


CLASSES = (Preferences, Connect, Disconnect, Panel)


def register():
    for one in CLASSES:
        bpy.utils.register_class(one)


def unregister():
    end()
    if bpy.app.timers.is_registered(step):
        bpy.app.timers.unregister(step)
    for one in reversed(CLASSES):
        bpy.utils.unregister_class(one)
