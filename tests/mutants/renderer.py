"""Mutants of the renderer, luminaires apart."""

from tests.mutants.mutant import mutants_of

RENDERER = "services/renderer/"
PASSES = RENDERER + "passes/"

MUTANTS = [
    *mutants_of(RENDERER + "frame_budget.py", "tests/test_frame_budget.py", [
        ("newest frame doubled", "NEWEST_WEIGHT = 0.2", "NEWEST_WEIGHT = 0.4"),
        ("least refresh doubled", "MIN_REFRESH = 1 / 24", "MIN_REFRESH = 1 / 12"),
        ("least refresh halved", "MIN_REFRESH = 1 / 24", "MIN_REFRESH = 1 / 48"),
        ("most refresh doubled", "MAX_REFRESH = 1 / 8", "MAX_REFRESH = 1 / 4"),
        ("most refresh halved", "MAX_REFRESH = 1 / 8", "MAX_REFRESH = 1 / 16"),
        ("fraction of a light's cost halved", "LOOKUP_FRACTION = 2 / 3", "LOOKUP_FRACTION = 1 / 3"),
        ("redrawn maps for the cache", "MAX_REDRAWN = 3 / 4", "MAX_REDRAWN = 3 / 8"),
        ("fewest lights doubled", "MIN_LIGHTS = 8", "MIN_LIGHTS = 16"),
        ("fewest lights halved", "MIN_LIGHTS = 8", "MIN_LIGHTS = 4"),
        ("late frames", "LATE = 1.15", "LATE = 2.3"),
        ("coarsened later", "COARSEN_ABOVE, REFINE_BELOW = 2.0, 0.125", "COARSEN_ABOVE, REFINE_BELOW = 4.0, 0.125"),
        ("refined sooner", "COARSEN_ABOVE, REFINE_BELOW = 2.0, 0.125", "COARSEN_ABOVE, REFINE_BELOW = 2.0, 1.0"),
    ]),
    *mutants_of(RENDERER + "gl/constants.py", "tests/test_gl_layout.py tests/test_shadow_maps.py tests/test_renderer_truth.py", [
        ("no gutter", "GUTTER = 2 ", "GUTTER = 0 "),
        ("shadow bias doubled", "SHADOW_BIAS_TEXELS = 1.0", "SHADOW_BIAS_TEXELS = 4.0"),
        ("shadow bias none", "SHADOW_BIAS_TEXELS = 1.0", "SHADOW_BIAS_TEXELS = 0.1"),
        ("number of a material", "GGX = 2", "GGX = 4"),
    ]),
    *mutants_of(PASSES + "near_lights/near_light_plan.py", "tests/test_near_light_drawing.py tests/test_near_light_plan.py", [
        ("strong near lights doubled", "STRONG = 0.3", "STRONG = 0.05"),
        ("narrow near lights are coarse", "NARROW_RAD = 0.005", "NARROW_RAD = 0.0"),
        ("near lights kept for ever", "KEPT_RAD = np.radians(0.1)", "KEPT_RAD = np.radians(90)"),
        ("dark near lights drawn", "np.flatnonzero(added > 0)", "np.flatnonzero(added >= 0)"),
    ]),
    *mutants_of(PASSES + "near_lights/near_light_plan.py", "tests/test_near_light_plan.py", [
        ("near lights lost for time", "    np.add.at(given, nearest, given[count:])\n", ""),
        ("no layer to spare", "count + math.ceil(SPARE_SLOTS * count)", "count"),
        ("coarse maps for ever", "not count <= len(layers.ids) <= ROOMY * slots", "len(layers.ids) < count"),
        ("drawn by noise", "-octaves(added[shining])", "-added[shining]"),
    ]),
    *mutants_of(RENDERER + "rays/bounce.py", "tests/test_near_light_plan.py", [
        ("bounce of lights from inside", "reach = max(far, radius, LEAST_REACH)", "reach = far"),
    ]),
    *mutants_of(PASSES + "near_lights/near_light_maps.glsl", "tests/test_near_light_drawing.py", [
        ("faces where the light is now", "face_of(away)", "face_of(position - near_lights[i].at)"),
    ]),
    *mutants_of(PASSES + "near_lights/near_light.glsl", "tests/test_near_light_drawing.py", [
        ("near lights fall with distance", "1.0 / (reach * reach)", "1.0 / reach"),
        ("no light from inside", "max(near_lights[i].radius, MIN_DISTANCE_M)", "0.0"),
    ]),
    *mutants_of(PASSES + "near_lights/near_matte.frag", "tests/test_near_light_drawing.py", [
        ("catchers without the other lights", "vec3 whole = unshadowed + near.rgb / near.a;", "vec3 whole = near.rgb / near.a;"),
    ]),
    *mutants_of(PASSES + "near_lights/near_light_map.frag", "tests/test_near_light_drawing.py", [
        ("casters within the radius", "if (dot(from_light, from_light) < light_radius * light_radius) discard;", ""),
    ]),
    *mutants_of(PASSES + "shadow_maps/shadow_alpha_test.frag", "tests/test_alpha_test.py", [
        ("masks within the radius", "if (dot(from_light, from_light) < light_radius * light_radius) discard;", ""),
    ]),
    *mutants_of(PASSES + "luminaires/depth_range.py", "tests/test_near_light_drawing.py tests/test_luminaire_illumination.py", [
        ("the farthest mesh", 'np.quantile(farthest, QUARTER, method="lower")', "farthest.max()"),
    ]),
    *mutants_of(PASSES + "luminaires/occluders.py", "tests/test_near_light_drawing.py", [
        ("long triangles", "= seen_short((mesh.geometry for mesh in scene.meshes), scene.camera)",
         "= [each.geometry for each in scene.meshes]"),
    ]),
    *mutants_of(RENDERER + "rays/near_tracing.py", "tests/test_near_light_drawing.py", [
        ("live penumbrae of dots", "    if whole:\n        return arriving\n", "    return arriving\n"),
        ("rays go through the ball", "(w - np.sqrt(inside))", "(w + np.sqrt(inside))"),
        ("dark where no ray was sent", "packet.sent[k] > LEAST_SENT else around", "packet.sent[k] > LEAST_SENT else np.float32(0)"),
    ]),
    *mutants_of(RENDERER + "rays/surfaces.py", "tests/test_rays.py", [
        ("rays begin on their surface", "LIFT_OF_DISTANCE, LIFT_OF_REACH = 5e-6, 5e-7", "LIFT_OF_DISTANCE, LIFT_OF_REACH = 0.0, 0.0"),
        ("rays begin far off it", "LIFT_OF_DISTANCE, LIFT_OF_REACH = 5e-6, 5e-7", "LIFT_OF_DISTANCE, LIFT_OF_REACH = 5e-3, 5e-4"),
    ]),
    *mutants_of(RENDERER + "rays/tracing.py", "tests/test_weak_lights.py", [
        ("tiles done at once", "TILE_AGREED, PIXEL_AGREED, BUSY = 2, 4, 2", "TILE_AGREED, PIXEL_AGREED, BUSY = 0, 4, 2"),
        ("pixels done by chance", "if packet.mixed[pixel] == 0 and mixed < BUSY:", "if True:"),
    ]),
    *mutants_of(RENDERER + "rays/edge_samples.py", "tests/test_edges.py", [
        ("the farthest neighbour", 'axis=1), kind="stable")', 'axis=1), kind="stable")[::-1]'),
    ]),
    *mutants_of(RENDERER + "pass_order.py", "tests/test_frame_plan.py", [
        ("mirrors that end with the bounce", "if setup.bounces and first and setup", "if lighting.bounce and first and setup"),
    ]),
    *mutants_of(RENDERER + "frame_plan.py", "tests/test_weak_lights.py", [
        ("the newest of the bounce", "(oldest, before), *others = gathered.items()", "*others, (oldest, before) = gathered.items()"),
    ]),
    *mutants_of(RENDERER + "rays/embree.py", "tests/test_rays.py", [
        ("moved meshes where they were", "rest @ matrices[k, :3, :3].T + (matrices[k, :3, 3] - self.origin)", "rest - self.origin"),
    ]),
    *mutants_of(RENDERER + "rays/holes.py", "tests/test_rays.py", [
        ("masks without holes", "if alpha < cutoff:", "if alpha < 0:"),
        ("coverage takes all", "context[ray] *= 1 - ", "context[ray] *= 0 * "),
    ]),
    *mutants_of(RENDERER + "rays/bounce.py", "tests/test_bounce.py", [
        ("chosen lights count once", "share += step / brought[i]", "share = np.float32(1.0)"),
        ("sparks of lamps beside walls", "blur = np.float32(0.75) * footprint", "blur = np.float32(0.0) * footprint"),
        ("albedo twice", "= albedo / PI *", "= albedo *"),
        ("catchers as in the scene file", "ground[axis] if albedo < 0 else albedo", "max(albedo, np.float32(0.0))"),
        ("light through roofs", "if query.rays[FAR, k] >= 0:", "if query.rays[FAR, k] >= -np.inf:"),
        ("irradiance without pi", "+= PI / count *", "+= 1 / count *"),
        ("mirrored away", "2 * height * nx - vx / length", "vx / length"),
    ]),
    *mutants_of(RENDERER + "rays/mirror.py", "tests/test_mirrors.py", [
        ("views not mirrored", "mx, my, mz = twice * nx - vx, twice * ny - vy, twice * nz - vz", "mx, my, mz = vx, vy, vz"),
        ("halfway vectors as directions", "2 * between * dx - vx, 2 * between * dy - vy, 2 * between * dz - vz", "dx, dy, dz"),
        ("rays that meet nothing count as others", "shown[pixel, 3] += weight", "shown[pixel, 3] += 0 * weight"),
    ]),
    *mutants_of(PASSES + "gloss/gloss.frag", "tests/test_mirrors.py", [
        ("the map behind the scene", "mix(visible, 1.0 - texelFetch(mirrored_scene, pixel, 0).a,", "mix(visible, 1.0,"),
    ]),
    *mutants_of(PASSES + "mirrors/scene_rays.glsl", "tests/test_mirrors.py", [
        ("another lobe than the gather's", "GATHERED_VARIANCE = 0.1", "GATHERED_VARIANCE = 0.2"),
    ]),
    *mutants_of(PASSES + "bounce/bounce.frag", "tests/test_mirrors.py", [
        ("the scene twice", "mirrored *= 1.0 - scene_rays", "mirrored *= 1.0 - 0.0 * scene_rays"),
    ]),
    *mutants_of(RENDERER + "rays/hits.py", "tests/test_bounce.py", [
        ("directions uniform", "radius = np.sqrt(u)", "radius = u"),
        ("unlit without its vertices", "emission * own if meshes.unlit[mesh] else emission", "emission"),
        ("dielectrics without their reflectance", "min(reflectance + (1 - reflectance)", "min((1 - reflectance)"),
    ]),
    *mutants_of(RENDERER + "shadows.py", "tests/test_rays.py", [
        ("rays on a GPU", "(shadow_map is not None or not on_processor)", "(shadow_map is not None)"),
        ("rays in spite of a resolution of maps", "(shadow_map is not None or not on_processor)", "not on_processor"),
    ]),
    *mutants_of(PASSES + "lights/traced_lights.py", "tests/test_rays.py", [
        ("lights kept for twice the turn", "KEPT_RAD = np.radians(0.1)", "KEPT_RAD = np.radians(0.3)"),
        ("lights traced for nothing", "KEPT_RAD = np.radians(0.1)", "KEPT_RAD = np.radians(0.03)"),
    ]),
    *mutants_of(PASSES + "shadow_maps/light_frames.comp", "tests/test_shadow_maps.py", [
        ("gutter in one language only", "vec3(0.5 * resolution - GUTTER, 0.5", "vec3(0.5 * resolution, 0.5"),
    ]),
    *mutants_of(PASSES + "shadow_maps/shadow_map_cache.py", "tests/test_shadow_map_cache.py", [
        ("served within a texel", "<= texel_rad(", "<= 2 * texel_rad("),
        ("errors by direction alone: age", "    error += slots.drift_rad\n", ""),
        ("errors by direction alone: resolution", "    error += np.abs(", "    error += 0 * np.abs("),
    ]),
    *mutants_of(PASSES + "shadow_maps/shadow_map_resolution.py", "tests/test_shadow_map_resolution.py", [
        ("lights with one shadow doubled", "SAME_SHADOW_TEXELS = 4", "SAME_SHADOW_TEXELS = 8"),
        ("lights with one shadow halved", "SAME_SHADOW_TEXELS = 4", "SAME_SHADOW_TEXELS = 2"),
        ("strong lights doubled", "STRONG_FRACTION = 1 / 8", "STRONG_FRACTION = 1 / 4"),
        ("strong lights halved", "STRONG_FRACTION = 1 / 8", "STRONG_FRACTION = 1 / 16"),
        ("hysteresis doubled", "HYSTERESIS = 0.2", "HYSTERESIS = 0.4"),
        ("hysteresis halved", "HYSTERESIS = 0.2", "HYSTERESIS = 0.1"),
        ("largest maps doubled", "MAX_RESOLUTION = 1024", "MAX_RESOLUTION = 2048"),
        ("full resolution", "FULL_FRACTION = 0.4", "FULL_FRACTION = 0.8"),
        ("growth with power", "EXPONENT = 3 / 4", "EXPONENT = 3 / 8"),
        ("halvings", "MAX_HALVINGS = 4", "MAX_HALVINGS = 5"),
        ("halvings for lack of time", "MAX_COARSENING = 2", "MAX_COARSENING = 4"),
        ("smallest maps doubled", "MIN_RESOLUTION = 16", "MIN_RESOLUTION = 32"),
    ]),
    *mutants_of(PASSES + "shadow_maps/casters.py", "tests/test_casters.py", [
        ("casters' margin: the tenth of a box that grows", "MARGIN = 0.1", "MARGIN = 0.5"),
        ("casters' margin: none", "MARGIN = 0.1", "MARGIN = 0.0"),
        ("tolerance of a pierced ground", "SUNK = 1e-4", "SUNK = 1e-1"),
    ]),
    *mutants_of(PASSES + "shadow_maps/simplification.py", "tests/test_casters.py", [
        ("triangles worth a level x 10", "MIN_TRIANGLES = 500", "MIN_TRIANGLES = 5000"),
        ("triangles worth a level halved", "MIN_TRIANGLES = 500", "MIN_TRIANGLES = 250"),
        ("casters' quantile", "QUANTILE = 0.999", "QUANTILE = 0.5"),
    ]),
    *mutants_of(PASSES + "shadow_maps/visibility.glsl", "tests/test_shadow_maps.py", [
        ("normal bias doubled", "MAX_NORMAL_BIAS = 3.0", "MAX_NORMAL_BIAS = 12.0"),
        ("normal bias to 1", "MAX_NORMAL_BIAS = 3.0", "MAX_NORMAL_BIAS = 1.0"),
        ("slope of the receiver", "MIN_SLOPE_COSINE = 0.03", "MIN_SLOPE_COSINE = 0.3"),
    ]),
    *mutants_of(PASSES + "gloss/gloss.frag", "tests/test_gloss.py", [
        ("the lobe's tails as wide as its core", "0.812, 2.91, 10.776, 49.746", "0.232, 0.232, 0.232, 0.232"),
        ("a lobe of no rows", "MAX_REACH = 2.0", "MAX_REACH = 0.01"),
        ("levels between levels", "(times * exp2(-2.0 * level) - 1.0) / 3.0", "0.0", "a half narrower on average, which spheres hide"),
        ("gloss without shadows", "lit.y > 0.0 ? lit.x / lit.y : 1.0", "1.0"),
    ]),
    *mutants_of(PASSES + "gloss/lobe_albedo.glsl", "tests/test_gloss.py", [
        ("Phong's albedo above the horizon alone", "return view * above + deviation", "return view * 0.9 + deviation"),
    ]),
    *mutants_of(PASSES + "gloss/lobe_sources.glsl", "tests/test_gloss.py", [
        ("lights for narrow lobes", "GGX_FADE = vec2(0.25, 0.09)", "GGX_FADE = vec2(0.09, 0.03)"),
        ("the map for wide lobes", "GGX_FADE = vec2(0.25, 0.09)", "GGX_FADE = vec2(1.0, 0.8)"),
        ("lights for narrow Phong lobes", "PHONG_FADE = vec2(6.0, 30.0)", "PHONG_FADE = vec2(60.0, 300.0)"),
    ]),
    *mutants_of(PASSES + "gloss/prefilter.glsl", "tests/test_gloss.py", [
        ("a level of the taps' middle alone", "    return sum / 7.0;", "    return sum / 6.0;"),
        ("a hexagon turned", "high = 0.8660254 * up", "high = 0.5 * up"),
    ]),
    *mutants_of(PASSES + "gloss/prefiltered_map.py", "tests/test_gloss.py", [
        ("spacing of the taps", "HEXAGON_VARIANCE = 6 / 7 / 2", "HEXAGON_VARIANCE = 6 / 7 / 8"),
        ("texels as large as cells", "TEXELS_PER_CELL = 1.3", "TEXELS_PER_CELL = 0.4"),
    ]),
    *mutants_of(PASSES + "gloss/lobe_albedo.py", "tests/test_gloss.py", [
        ("a coarse quadrature", "STEPS, TURNS = 128, 24", "STEPS, TURNS = 4, 24"),
    ]),
    *mutants_of("services/light/reflected_light.py", "tests/test_gloss.py", [
        ("a window's light is a source", "ISOLATED = (0.1, 0.3)", "ISOLATED = (10.0, 30.0)"),
        ("no light is a source", "COMPACT = (0.25, 0.5)", "COMPACT = (25.0, 50.0)"),
        ("every light is a source", "COMPACT = (0.25, 0.5)", "COMPACT = (-2.0, -1.0)"),
        ("sources of one cell", "SOURCE_RADIUS = 1.5", "SOURCE_RADIUS = 0.6"),
        ("a lamp's lights stay in the map", "DENSE = (1.5, 2.5)", "DENSE = (0.1, 0.2)"),
        ("gaps between a lamp's lights", "GAUSSIAN_SPACING = 0.5", "GAUSSIAN_SPACING = 0.2"),
        ("a lamp's lights blurred", "GAUSSIAN_SPACING = 0.5", "GAUSSIAN_SPACING = 1.0"),
    ]),
    *mutants_of(PASSES + "lights/light_regions.py", "tests/test_light_regions.py", [
        ("rounding of regions: none", "ROUNDING = 1e-3", "ROUNDING = -1e-1"),
        ("sides of a cube's faces", "CUBE_SIDE = 32", "CUBE_SIDE = 2", "regions reach as far as their texels: slower, as exact"),
    ]),
    *mutants_of(RENDERER + "output/tonemap.py", "tests/test_tonemap.py", [
        ("tone-mapping cut-off x 100", "MIN_LUMINANCE = 1e-4", "MIN_LUMINANCE = 1e-2"),
        ("tone-mapping cut-off / 100", "MIN_LUMINANCE = 1e-4", "MIN_LUMINANCE = 1e-6"),
        ("time constant doubled", "TIME_CONSTANT_S = 0.4", "TIME_CONSTANT_S = 0.8"),
        ("time constant halved", "TIME_CONSTANT_S = 0.4", "TIME_CONSTANT_S = 0.2"),
        ("longest step doubled", "MAX_STEP_S = 0.25", "MAX_STEP_S = 0.5"),
        ("middle grey doubled", "MIDDLE_GREY = 0.18", "MIDDLE_GREY = 0.36"),
        ("range of the key", "KEY_RANGE = 4.0", "KEY_RANGE = 2.0"),
        ("quantiles", "QUANTILES = (0.01, 0.99)", "QUANTILES = (0.1, 0.9)"),
        ("pixels of the statistics", "MAX_STATISTICS_PIXELS = 65_536", "MAX_STATISTICS_PIXELS = 4_096"),
    ]),
    *mutants_of(RENDERER + "output/image_sequence.py", "tests/test_image_sequence.py", [
        ("columns of a contact sheet", "CONTACT_SHEET_COLUMNS = 6", "CONTACT_SHEET_COLUMNS = 4"),
        ("pictures of a contact sheet", "CONTACT_SHEET_PICTURES = 24", "CONTACT_SHEET_PICTURES = 12"),
        ("half of a picture left", '            exr.unlink(missing_ok=True)\n', ""),
        ("pictures of a restarted source", "if self.last and stamp.sequence + self._renumbered <= self.last.sequence:", "if False:"),
    ]),
    *mutants_of(RENDERER + "output/video.py", "tests/test_video.py", [
        ("ticks of a second", "\nTICKS_PER_S = 90_000", "\nTICKS_PER_S = 1_000"),
        ("ticks beyond MPEG-4's", "MPEG4_TICKS_PER_S = 60_000", "MPEG4_TICKS_PER_S = 90_000"),
        ("visible loss of x264", '{"crf": "18"}', '{"crf": "40"}'),
        ("visible loss of VP9", '"crf": "20"', '"crf": "60"'),
        ("visible loss of MPEG-4", '"qmin": "2", "qmax": "2"', '"qmin": "12", "qmax": "12"'),
        ("decoders taken for encoders", "except (FFmpegError, ValueError):", "except FFmpegError:"),
    ]),
    *mutants_of(RENDERER + "scene/meshes.py", "tests/test_meshes.py", [
        ("crease angle doubled", "np.radians(40.0)", "np.radians(80.0)"),
        ("crease angle halved", "np.radians(40.0)", "np.radians(20.0)"),
        ("area of a triangle x 10^10", "MIN_RELATIVE_AREA = 1e-14", "MIN_RELATIVE_AREA = 1e-4"),
        ("area of a triangle / 10^10", "MIN_RELATIVE_AREA = 1e-14", "MIN_RELATIVE_AREA = 1e-24"),
    ]),
    *mutants_of(RENDERER + "scene/scene_limits.py", "tests/test_scene_limits.py tests/test_obj_files.py", [
        ("meshes doubled", "MAX_MESHES = 4096", "MAX_MESHES = 8192"),
        ("luminaires doubled", "MAX_LUMINAIRES = 256", "MAX_LUMINAIRES = 512"),
        ("corners doubled", "FREE_CORNERS = 2**20", "FREE_CORNERS = 2**21"),
        ("vertices doubled", "FREE_VERTICES = 2**22", "FREE_VERTICES = 2**23"),
    ]),
    *mutants_of(RENDERER + "scene/scene.py", "tests/test_scene.py", [
        ("scale beyond its limit", "MAX_SCALE = 1e9 ", "MAX_SCALE = 2e9 "),
    ]),
    *mutants_of(RENDERER + "scene/camera_table.py", "tests/test_scene.py tests/test_gltf_cameras.py", [
        ("cameras anywhere", "if not np.abs(points).max() <= MAX_COORDINATE_M or", "if"),
        ("roll without a word", "MAX_ROLL_DEG = 0.5", "MAX_ROLL_DEG = 50.0"),
    ]),
    *mutants_of(RENDERER + "scene/polygons.py", "tests/test_obj_files.py", [
        ("fans for all faces", "np.flatnonzero(~_fans_fill(points))", "np.flatnonzero(~_fans_fill(points))[:0]"),
        ("fans that go round twice", "(turned < 2 * np.pi)", "(turned < 20 * np.pi)", "such faces cross themselves and come as fans"),
    ]),
    *mutants_of(RENDERER + "scene/polygon_ears.py", "tests/test_obj_files.py", [
        ("ears of hollow corners", "turn > 0 if pass_by == STRICT else turn >= 0", "True"),
        ("corners at one place", "if x[p] == x[q] and y[p] == y[q]:", "if False:"),
    ]),
    *mutants_of(RENDERER + "scene/obj_files.py", "tests/test_obj_files.py", [
        ("negative numbers from the file's end", "np.repeat(before, counts)", "size"),
    ]),
    *mutants_of(RENDERER + "scene/stl_files.py", "tests/test_ply_files.py", [
        ("no bytes behind a binary STL", "if 0 < count <= (len(content) - HEADER_BYTES) // TRIANGLE.itemsize:",
         "if 0 < count == (len(content) - HEADER_BYTES) / TRIANGLE.itemsize:"),
    ]),
    *mutants_of(RENDERER + "scene/mesh_files.py", "tests/test_scene_limits.py", [
        ("stretched instances cleaned once", "> 1 and _keeps_shape(mesh.file_from_mesh[:3, :3])", "> 1"),
    ]),
    *mutants_of(RENDERER + "scene/usd_layers.py", "tests/test_usd_files.py", [
        ("layers anywhere", "if not Path(real).is_relative_to(self._folder) or", "if"),
        ("layers of layers unseen", "waiting += self._named_by(layer)", "self._named_by(layer)"),
        ("packages compressed", "entry.compress_type != zipfile.ZIP_STORED or", ""),
    ]),
    *mutants_of(RENDERER + "scene/usd_meshes.py", "tests/test_usd_files.py", [
        ("left-handed faces as they are", "triangles = triangles[:, ::-1]", "triangles = triangles[:, :]"),
        ("holes drawn", "kept[holes[(holes >= 0) & (holes < len(counts))]] = False", "kept[:] = True"),
    ]),
    *mutants_of(RENDERER + "scene/gltf_lights.py", "tests/test_gltf_lights.py", [
        ("lamps along +z", "np.diag([1.0, -1.0, -1.0, 1.0])", "np.eye(4)"),
        ("falloff not squared", "scale, 0, 1) ** 2", "scale, 0, 1)"),
    ]),
    *mutants_of(RENDERER + "scene/gltf.py", "tests/test_gltf.py", [
        ("bytes of a glTF doubled", "MAX_BYTES = 2**30", "MAX_BYTES = 2**31"),
        ("numbers on top of each other doubled", "FREE_NUMBERS = 2**24", "FREE_NUMBERS = 2**25"),
    ]),
    *mutants_of(RENDERER + "scene/gltf_nodes.py", "tests/test_scene_limits.py", [
        ("depth doubled", "MAX_DEPTH = 256", "MAX_DEPTH = 512"),
    ]),
    *mutants_of(RENDERER + "scene/gltf_materials.py", "tests/test_scene_limits.py", [
        ("notes doubled", "MAX_NOTES = 20", "MAX_NOTES = 40"),
    ]),
    *mutants_of(RENDERER + "scene/animation.py", "tests/test_animation.py tests/test_scene_limits.py", [
        ("moving nodes doubled", "MAX_MOVING_NODES = 768", "MAX_MOVING_NODES = 1536"),
        ("keyframes", "MAX_KEYFRAMES = 2**22", "MAX_KEYFRAMES = 100"),
        ("animation keys cut to the first", "chosen = keys[np.unique(", "chosen = keys[:1][0 * np.unique("),
        ("length of a rotation", "MIN_QUATERNION = 1e-6", "MIN_QUATERNION = 0.99"),
        ("degenerate nodes", "MIN_DETERMINANT = 1e-18", "MIN_DETERMINANT = 1e-1"),
    ]),
    *mutants_of(RENDERER + "scene/scene.py", "tests/test_scene.py", [
        ("distance from the origin doubled", "MAX_RELATIVE_OFFSET = 1000", "MAX_RELATIVE_OFFSET = 10000"),
        ("bends of a shadow catcher", "FLAT = 1e-3", "FLAT = 1e-1"),
    ]),
    *mutants_of(RENDERER + "scene/textures.py", "tests/test_materials.py tests/test_gltf_textures.py", [
        ("side of a texture doubled", "MAX_TEXTURE_SIDE = 4096", "MAX_TEXTURE_SIDE = 8192"),
    ]),
]
