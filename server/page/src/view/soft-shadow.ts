import * as THREE from "three";

// 1.2 m around the robot's root in 128 pixels: 9 mm each, which the blur hides. More pixels cost frames in software.
const HALF_M = 0.6;
const PIXELS = 128;
const SHADOW_Z_M = -0.001;
// Layer of what casts a shadow, beside the layer that the camera draws.
const SHADOW_LAYER = 1;
const BLUR_PX = 1.1;

const FLATTEN = /* glsl */ `
  uniform vec3 light;
  uniform float half_m;
  varying float height;
  void main() {
    vec4 at = modelMatrix * vec4(position, 1.0);
    height = max(at.z, 0.0);
    gl_Position = vec4((at.xy - light.xy / light.z * height) / half_m, 0.0, 1.0);
  }`;

// What is higher casts a fainter shadow, as of a wide lamp.
const DARKEN = /* glsl */ `
  varying float height;
  void main() { gl_FragColor = vec4(1.0, 1.0, 1.0, 1.0) * mix(1.0, 0.35, min(height / 0.35, 1.0)); }`;

const FULL_SCREEN = /* glsl */ `
  varying vec2 place;
  void main() { place = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }`;

const BLUR = /* glsl */ `
  uniform sampler2D picture;
  uniform vec2 step_uv;
  varying vec2 place;
  void main() {
    float sum = texture2D(picture, place).r * 0.2;
    sum += (texture2D(picture, place + step_uv).r + texture2D(picture, place - step_uv).r) * 0.17;
    sum += (texture2D(picture, place + 2.0 * step_uv).r + texture2D(picture, place - 2.0 * step_uv).r) * 0.13;
    sum += (texture2D(picture, place + 3.0 * step_uv).r + texture2D(picture, place - 3.0 * step_uv).r) * 0.1;
    gl_FragColor = vec4(sum);
  }`;

const ON_GROUND = /* glsl */ `
  varying vec2 place;
  void main() { place = uv; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0); }`;

const LAY = /* glsl */ `
  uniform sampler2D picture;
  uniform float strength;
  varying vec2 place;
  void main() { gl_FragColor = vec4(0.0, 0.0, 0.02, texture2D(picture, place).r * strength); }`;

/** Soft shadow on the ground: the arm, flattened along the light and blurred, without a shadow map in every material. */
export class SoftShadow {
  private readonly sharp = target();
  private readonly blurred = target();
  private readonly camera = new THREE.OrthographicCamera(-100, 100, 100, -100, -100, 100);
  private readonly flatten: THREE.ShaderMaterial;
  private readonly blur: THREE.ShaderMaterial;
  private readonly ground: THREE.Mesh<THREE.PlaneGeometry, THREE.ShaderMaterial>;
  private readonly blur_scene = new THREE.Scene();

  constructor(
    private readonly scene: THREE.Scene,
    light: THREE.Vector3,
  ) {
    this.camera.layers.set(SHADOW_LAYER);
    const plain = { depthTest: false, depthWrite: false };
    this.flatten = new THREE.ShaderMaterial({
      vertexShader: FLATTEN,
      fragmentShader: DARKEN,
      uniforms: { light: { value: light }, half_m: { value: HALF_M } },
      side: THREE.DoubleSide,
      ...plain,
    });
    this.blur = new THREE.ShaderMaterial({
      vertexShader: FULL_SCREEN,
      fragmentShader: BLUR,
      uniforms: { picture: { value: null }, step_uv: { value: [0, 0] } },
      ...plain,
    });
    const full = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), this.blur);
    full.frustumCulled = false;
    this.blur_scene.add(full);
    const lay = new THREE.ShaderMaterial({
      vertexShader: ON_GROUND,
      fragmentShader: LAY,
      uniforms: { picture: { value: this.sharp.texture }, strength: { value: 0 } },
      transparent: true,
      depthWrite: false,
    });
    this.ground = new THREE.Mesh(new THREE.PlaneGeometry(2 * HALF_M, 2 * HALF_M), lay);
    this.ground.position.z = SHADOW_Z_M;
    this.ground.renderOrder = -1;
    this.ground.visible = false;
    scene.add(this.ground);
  }

  setStrength(strength: number): void {
    this.ground.material.uniforms.strength!.value = strength;
  }

  /** Draw the shadow of an object into its texture; to be called when the object has moved. */
  cast(renderer: THREE.WebGLRenderer, object: THREE.Object3D): void {
    object.traverse((node) => node.layers.enable(SHADOW_LAYER));
    this.scene.overrideMaterial = this.flatten;
    renderer.setClearColor(0x000000, 0);
    renderer.setRenderTarget(this.sharp);
    renderer.render(this.scene, this.camera);
    this.scene.overrideMaterial = null;
    this.pass(renderer, this.sharp, this.blurred, [BLUR_PX / PIXELS, 0]);
    this.pass(renderer, this.blurred, this.sharp, [0, BLUR_PX / PIXELS]);
    renderer.setRenderTarget(null);
    this.ground.visible = true;
  }

  private pass(renderer: THREE.WebGLRenderer, from: THREE.WebGLRenderTarget, to: THREE.WebGLRenderTarget, step_uv: number[]): void {
    this.blur.uniforms.picture!.value = from.texture;
    this.blur.uniforms.step_uv!.value = step_uv;
    renderer.setRenderTarget(to);
    renderer.render(this.blur_scene, this.camera_of_blur);
  }

  private readonly camera_of_blur = new THREE.OrthographicCamera();
}

function target(): THREE.WebGLRenderTarget {
  const options = { depthBuffer: false, minFilter: THREE.LinearFilter, magFilter: THREE.LinearFilter, generateMipmaps: false };
  return new THREE.WebGLRenderTarget(PIXELS, PIXELS, options);
}
