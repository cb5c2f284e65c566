"""What near lights give to shadow catchers: it depends on the place, and so each pixel's matte is made anew once all lights are summed."""

import moderngl

from vemlight.renderer.gl.programs import Programs
from vemlight.renderer.passes.lights.shading import Shading
from vemlight.renderer.scene.materials import Colour


class NearMatte:
    """Sums of what near lights give to catchers in pictures of `size` pixels (width, height). frame: the sums, of what shadows take and of
    what there would be without."""

    def __init__(self, context: moderngl.Context, programs: Programs, shading: Shading, size: tuple[int, int]) -> None:
        self._context, self._shading = context, shading
        self._taken, self._unshadowed, self._made = (context.texture(size, 4, dtype="f4") for _ in range(3))
        self.frame = context.framebuffer([self._taken, self._unshadowed], shading.class_depth)
        self.frame.depth_mask = False  # as in Shading
        self._made_frame = context.framebuffer([self._made])
        self._array = context.vertex_array(programs.program("screen.vert", "near_matte.frag"), [])

    def clear(self) -> None:
        """Empties the sums."""
        self.frame.clear()

    def apply(self, unshadowed: Colour) -> None:
        """Brings the sums into the matte and the picture's alpha. unshadowed: irradiance of a catcher by all other lights."""
        shading, program = self._shading, self._array.program
        assert shading.matte
        assert shading.matte_frame
        textures = {"matte": shading.matte, "near_taken": self._taken, "near_unshadowed": self._unshadowed}
        for unit, (name, texture) in enumerate(textures.items()):
            texture.use(unit)
            program[name] = unit
        program["unshadowed"] = unshadowed
        self._context.enable_only(moderngl.NOTHING)
        self._made_frame.use()
        program["difference"] = False
        self._array.render(moderngl.TRIANGLES, vertices=3)
        self._context.enable_only(moderngl.BLEND)
        self._context.blend_func = moderngl.ONE, moderngl.ONE
        shading.frame.use()
        program["difference"] = True
        self._array.render(moderngl.TRIANGLES, vertices=3)
        self._context.copy_framebuffer(shading.matte_frame, self._made_frame)

    def release(self) -> None:
        """Frees what this holds on the GPU."""
        for resource in (self._array, self.frame, self._made_frame, self._taken, self._unshadowed, self._made):
            resource.release()
