"""Mutants of light fields between two planes."""

from tests.mutants.mutant import mutants_of

PACKAGE = "services/renderer/luminaire/"
LIGHT = "services/light/"
T = "tests/test_luminaire_"

MUTANTS = [
    *mutants_of(PACKAGE + "bases.py", f"{T}bases.py", [
        ("reach of a span dual halved", "SPAN_REACH = 24", "SPAN_REACH = 12"),
        ("reach of a compact dual", "SUPPORT_CELLS[kind] / 2)) - 1", "SUPPORT_CELLS[kind] / 2)) - 2"),
        ("neighbouring shifts of a dual", "for step in (-1, 0, 1)", "for step in (0, 1)"),
        ("the spline's outer piece", "0.5 * (1.5 - a) ** 2", "0.4 * (1.5 - a) ** 2"),
    ]),
    *mutants_of(PACKAGE + "acquisition.py", f"{T}acquisition.py {T}lightfield.py", [
        ("forward rays", "MIN_FORWARD_Z = 1e-6", "MIN_FORWARD_Z = 1e-5", "rays so flat carry no flux to the planes"),
        ("flat rays in the waist doubled", "MIN_WAIST_Z = 0.05", "MIN_WAIST_Z = 0.1"),
        ("flat rays in the waist halved", "MIN_WAIST_Z = 0.05", "MIN_WAIST_Z = 0.025"),
        ("steps of a quantised value", "steps = 2**bits - 1", "steps = 2**bits"),
        ("pixel of a ray", "+ 1) / 2 * size", "+ 1) / 2 * (size - 1)"),
        ("cos^4 of an acquisition", "(1 + tan2) ** 2))[..., None]", "(1 + tan2)))[..., None]"),
        ("negative slides", "for sign in (1, -1)]", "for sign in (1, 1)]"),
    ]),
    *mutants_of(PACKAGE + "method_choice.py", f"{T}method_choice.py", [
        ("auto takes the worse", "shift_invariant_error <= sampling_error", "shift_invariant_error >= sampling_error"),
        ("noise left doubled", "NOISE = 0.1", "NOISE = 0.2", "tests take NOISE itself: what a pixel may have is a matter of taste"),
        ("fall-off of a spot", "points[:, 2] ** 2 / squared**2", "points[:, 2] / squared**2"),
        ("box between pixels", "sums[j, i] * (1 - a) + sums[j, i + 1] * a,", "sums[j, i],"),
    ]),
    *mutants_of(PACKAGE + "shift_invariant.py", f"{T}shift_invariant.py", [
        ("error accepted doubled", "MAX_RELATIVE_ERROR = 0.08", "MAX_RELATIVE_ERROR = 0.16"),
        ("error accepted halved", "MAX_RELATIVE_ERROR = 0.08", "MAX_RELATIVE_ERROR = 0.04"),
        ("visible pixels doubled", "VISIBLE = 1e-3", "VISIBLE = 2e-3"),
        ("visible pixels halved", "VISIBLE = 1e-3", "VISIBLE = 5e-4"),
        ("half a support in the bound", "for change in (-half, 0.0, half))", "for change in (-half / 2, 0.0, half / 2))"),
        ("the bound accepts an equal error", "<= MAX_RELATIVE_ERROR", "< MAX_RELATIVE_ERROR", "no light field's bound is exactly 8 %"),
        ("geometric term", "** 2 * (1 + tan2) ** 2)[..., None]).astype", "** 2 * (1 + tan2))[..., None]).astype"),
    ]),
    *mutants_of("services/renderer/gl/constants.py", f"{T}illumination.py", [
        ("near plane doubled", "NEAR_FRACTION = 1e-3", "NEAR_FRACTION = 2e-3"),
    ]),
    *mutants_of(PACKAGE + "shadow_views.py", f"{T}illumination.py", [
        ("largest tangent halved", "MAX_TANGENT = 20.0", "MAX_TANGENT = 10.0"),
        ("cells of a bell", "(count + n - 1 for count", "(count + n - 2 for count"),
        ("middle of a cell", "= corner + h / 2", "= corner"),
        ("median", "rest, k = weights.sum() / 2, 0", "rest, k = weights.sum() / 3, 0"),
    ]),
    *mutants_of(PACKAGE + "tables.py", f"{T}tables.py", [
        ("boxes within two pixels", "j.last - j.first <= 1:\n        low =", "j.last - j.first <= 0:\n        low ="),
        ("mirrored between the planes", "a, b, low, high = b, a, high, low", "a, b = b, a"),
        ("weight of the first of two pixels", "(first + 1 - box.x0)", "(first - box.x0)"),
        ("search of the marginal", "if marginal <= target:", "if marginal < target:", "differs where a uniform number hits a sum exactly"),
        ("end of a column's search", "column, end = i.first, i.last + 1", "column, end = i.first, i.last"),
    ]),
    *mutants_of(PACKAGE + "estimator.py", f"{T}estimator.py", [
        ("systematic rounding", " - math.floor(passed + shifts[n, 2])", " - math.floor(passed)"),
        ("capped images", "count, divisor = max_per_image, float(max_per_image)", "count = max_per_image"),
        ("the sequence goes on from image to image", "drawn += count", "drawn += 0"),
        ("rays start off their surface", "RAY_START = 1e-4", "RAY_START = 1.0"),
        ("light from behind", "if cosine <= 0 or flat", "if flat"),
    ]),
    *mutants_of(LIGHT + "far_field.py", f"{T}photometry.py", [
        ("far-field distance doubled", "FAR_FIELD_SIZES = 5.0", "FAR_FIELD_SIZES = 10.0"),
        ("angles doubled", "MAX_ANGLES = 2000", "MAX_ANGLES = 4000"),
    ]),
    *mutants_of(LIGHT + "eulumdat.py", f"{T}photometry.py", [
        ("lamp sets doubled", "MAX_LAMP_SETS = 20", "MAX_LAMP_SETS = 40"),
        ("flux limit doubled", "MAX_FLUX_LM = 1e9", "MAX_FLUX_LM = 2e9"),
        ("lamp sets taken in turn", "flux = _flux_of_set(lines, max(lamp_set, 1))", "flux = _flux_of_set(lines, sets)"),
        ("round areas", "width or length, height", "width, height"),
        ("asymmetric lamps turned round", "3 * planes // 4", "planes // 4"),
    ]),
    *mutants_of(LIGHT + "lm63.py", f"{T}photometry.py", [
        ("feet", "0.3048", "0.3"),
        ("half a circle", "if last <= 180:", "if last < 180:"),
        ("the factor of 1991", "(86|91)", "(86)"),
    ]),
    *mutants_of(LIGHT + "photometry.py", f"{T}photometry.py", [
        ("noise below 0", "MAX_NEGATIVE = 0.01", "MAX_NEGATIVE = 0.2"),
    ]),
    *mutants_of(PACKAGE + "rayfile.py", f"{T}rayfile.py", [
        ("rays doubled", "MAX_RAYS = 2**28", "MAX_RAYS = 2**29"),
        ("items doubled", "MAX_ADDITIONAL_ITEMS = 1000", "MAX_ADDITIONAL_ITEMS = 2000"),
        ("unit vectors doubled", "DIRECTION_TOLERANCE = 1e-3", "DIRECTION_TOLERANCE = 2e-3"),
        ("unit vectors halved", "DIRECTION_TOLERANCE = 1e-3", "DIRECTION_TOLERANCE = 5e-4"),
        ("wavelengths doubled", "MAX_WAVELENGTHS = 10_000", "MAX_WAVELENGTHS = 20_000"),
        ("Stokes items", "(STOKES, 3)", "(STOKES, 4)"),
        ("millimetres", "rows[:, :3] * 1e-3", "rows[:, :3] * 1e-2"),
    ]),
    *mutants_of(PACKAGE + "authoring.py", f"{T}authoring.py", [
        ("flux made up for", "MAX_MADE_UP = 0.05", "MAX_MADE_UP = 5.0"),
        ("flux on the plane", "FLUX_ON_PLANE = 0.98", "FLUX_ON_PLANE = 0.5"),
        ("distance of the planes doubled", "DISTANCE_SPACINGS = 10", "DISTANCE_SPACINGS = 20"),
        ("half numbers that overflow", "if recipe.half and", "if False and"),
    ]),
    *mutants_of(PACKAGE + "luminaire_file.py", f"{T}file.py", [
        ("images of a file doubled", "MAX_IMAGES = 1024", "MAX_IMAGES = 2048"),
        ("first scanline", "field.images[j, i, ::-1], dtype", "field.images[j, i], dtype"),
        ("nan in images", "if not np.all(np.isfinite(stack)):", "if False:"),
    ]),
    *mutants_of("services/renderer/passes/luminaires/rasterised_luminaire.py", f"{T}illumination.py", [
        ("cells doubled", "MAX_CELLS = 2048", "MAX_CELLS = 4096"),
    ]),
    *mutants_of("services/renderer/passes/luminaires/depth_range.py", f"{T}illumination.py", [
        ("far plane of the maps", "FAR_MARGIN = 1.01", "FAR_MARGIN = 0.5"),
    ]),
    *mutants_of("services/renderer/passes/luminaires/cube_faces.glsl", f"{T}illumination.py", [
        ("map bias doubled", "MAP_BIAS = 0.5", "MAP_BIAS = 1.0"),
        ("map bias halved", "MAP_BIAS = 0.5", "MAP_BIAS = 0.25"),
        ("shadows outside the map", "return 1.0;\n    vec2 first", "return 0.0;\n    vec2 first", "a lamp is dark outside its window"),
    ]),
    *mutants_of("services/renderer/passes/luminaires/luminaire_spots.frag", f"{T}illumination.py", [
        ("weights of a spline's cells", "(a == 1 ? 4.0 : 1.0)", "(a == 1 ? 1.0 : 1.0)", "how softly a b-spline lamp's shadow fades"),
        ("what is clipped away is dark", "* inside;", ";", "images of the tested lamps end in darkness"),
    ]),
]
