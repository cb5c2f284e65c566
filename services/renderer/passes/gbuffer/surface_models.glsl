// From a material's parameters to what the G-buffer holds, a function for each class of vemlight.renderer.scene.materials; after material.glsl.
// colour: the material's times its texture and the vertices'. parameters: the texel of its other texture, 1 where there is none.

layout(std140) uniform MaterialBlock { Material material; };

struct SurfaceModel {
    vec3 albedo;
    vec3 reflectance;  // at normal incidence
    float lobe;  // Phong's exponent or GGX' alpha, roughness squared
    vec3 emission;  // radiance, before its texture
};

SurfaceModel phong_surface(vec3 colour, vec4 parameters) {
    return SurfaceModel(colour, material.specular, min(material.exponent, MAX_HALF), vec3(0.0));  // a narrower lobe is less than a pixel
}

// glTF 2.0, appendix B.2; parameters: metallic, roughness.
SurfaceModel metallic_roughness_surface(vec3 colour, vec4 parameters) {
    vec2 metallic_roughness = vec2(material.metallic, material.roughness) * parameters.rg;
    float roughness = max(metallic_roughness.y, MIN_ROUGHNESS);
    vec3 reflectance = mix(vec3(material.reflectance), colour, metallic_roughness.x);
    return SurfaceModel(colour * (1.0 - metallic_roughness.x), reflectance, roughness * roughness, material.emissive);
}

// KHR_materials_pbrSpecularGlossiness; parameters: specular, glossiness.
SurfaceModel specular_glossiness_surface(vec3 colour, vec4 parameters) {
    vec3 specular = material.specular * parameters.rgb;
    float roughness = max(1.0 - material.glossiness * parameters.a, MIN_ROUGHNESS);
    return SurfaceModel(colour * (1.0 - max(specular.r, max(specular.g, specular.b))), specular, roughness * roughness, material.emissive);
}

// KHR_materials_unlit.
SurfaceModel unlit_surface(vec3 colour, vec4 parameters) { return SurfaceModel(vec3(0.0), vec3(0.0), 0.0, colour); }
