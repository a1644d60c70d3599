import { Color, ShaderMaterial, SRGBColorSpace, Vector4, type ColorRepresentation } from "three";

const VERTEX = /* glsl */ `
  uniform vec4 tint;
  varying vec4 shade;
  void main() {
    shade = tint;
    #ifdef USE_COLOR_ALPHA
      shade *= color;
    #endif
    gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
    #ifdef FULL_SCREEN
      gl_Position = vec4(position.xy, 0.0, 1.0);
    #endif
  }`;

const FRAGMENT = /* glsl */ `
  varying vec4 shade;
  void main() { gl_FragColor = shade; }`;

/**
 * Create a material for what needs no light: sky, ground and reach.
 *
 * Its colours reach the screen as they are given. Those of three's materials are converted to sRGB at every pixel, which
 * costs as much as all else where the processor draws.
 *
 * @param colored_vertices - the geometry has an attribute `color` of four numbers, in sRGB.
 */
export function flatMaterial(colored_vertices: boolean): ShaderMaterial {
  return new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    uniforms: { tint: { value: new Vector4(1, 1, 1, 1) } },
    vertexColors: colored_vertices,
    transparent: true,
    depthWrite: false,
  });
}

/** Create a material for a geometry whose x and y are those of the screen, from -1 to 1, behind everything. */
export function backgroundMaterial(): ShaderMaterial {
  const material = flatMaterial(true);
  material.defines = { FULL_SCREEN: "" };
  material.transparent = material.depthTest = false;
  return material;
}

/** Set the colour of all vertices, or what theirs are multiplied by. */
export function setTint(material: ShaderMaterial, color: ColorRepresentation, opacity: number): void {
  (material.uniforms.tint!.value as Vector4).set(...srgb(color), opacity);
}

/** Return the red, green and blue of a colour in sRGB, from 0 to 1. */
export function srgb(color: ColorRepresentation): [number, number, number] {
  const { r, g, b } = new Color(color).getRGB({ r: 0, g: 0, b: 0 }, SRGBColorSpace);
  return [r, g, b];
}
