import { poseOfDevice, poseOfViewer, type PhonePose } from "../logic/phone-pose";

/** Receiver of the phone's poses; null for a moment in which the phone does not know its pose. */
export type TakePose = (pose: PhonePose | null, now_ms: number) => void;

export interface PoseSource {
  /** True where the position is known, not the orientation alone. */
  tracks_position: boolean;
  stop: () => void;
}

/** Failure to start a source; the key of a text says why. */
export class SourceError extends Error {
  override readonly name = "SourceError";

  constructor(readonly key: "phone.no_secure_context" | "phone.no_permission" | "phone.no_sensors" | "phone.no_overlay") {
    super(key);
  }
}

const FIRST_EVENT_MS = 2000;

/** iOS asks the user, after a press; other browsers do not have the function. */
type WithPermission = { requestPermission?: () => Promise<"granted" | "denied"> };

export async function canTrackPosition(): Promise<boolean> {
  try {
    return (await navigator.xr?.isSessionSupported("immersive-ar")) ?? false;
  } catch {
    return false;
  }
}

/** Start to listen to the device's orientation; called in the handler of a press, as iOS wants it. */
export async function startOrientation(take: TakePose): Promise<PoseSource> {
  // Browsers give no orientation to pages that came unencrypted (W3C, section 3.3).
  if (!window.isSecureContext || !("DeviceOrientationEvent" in window)) throw new SourceError("phone.no_secure_context");
  const { requestPermission } = DeviceOrientationEvent as unknown as WithPermission;
  if (requestPermission !== undefined && (await requestPermission()) !== "granted") throw new SourceError("phone.no_permission");
  return new Promise((resolve, reject) => {
    const onEvent = (event: DeviceOrientationEvent): void => {
      const pose = poseOfDevice(event, screen.orientation?.angle ?? 0);
      take(pose, performance.now());
      if (pose === null) return;
      clearTimeout(timer);
      resolve({ tracks_position: false, stop });
    };
    const stop = (): void => window.removeEventListener("deviceorientation", onEvent);
    const timer = setTimeout(() => {
      stop();
      reject(new SourceError("phone.no_sensors"));
    }, FIRST_EVENT_MS);
    window.addEventListener("deviceorientation", onEvent);
  });
}

/** Start to track the phone by WebXR, with the whole page over the camera's picture: STOP stays in sight. */
export async function startTracking(take: TakePose, onEnd: () => void): Promise<PoseSource> {
  const xr = navigator.xr;
  if (!xr) throw new SourceError("phone.no_sensors");
  const session = await xr.requestSession("immersive-ar", {
    requiredFeatures: ["local"],
    optionalFeatures: ["dom-overlay"],
    domOverlay: { root: document.body },
  });
  if (!session.domOverlayState) {
    // Without the page over the picture there would be no STOP.
    await session.end();
    throw new SourceError("phone.no_overlay");
  }
  // The page's own controls take every touch.
  document.body.addEventListener("beforexrselect", preventDefault);
  session.addEventListener("end", () => {
    document.body.removeEventListener("beforexrselect", preventDefault);
    onEnd();
  });
  await giveLayer(session);
  const space = await session.requestReferenceSpace("local");
  const onFrame = (_time: number, frame: XRFrame): void => {
    session.requestAnimationFrame(onFrame);
    const pose = frame.getViewerPose(space);
    // An emulated position is a guess of the browser while the camera sees nothing that it knows.
    const known = pose && !pose.emulatedPosition;
    take(known ? poseOfViewer(pose.transform.position, pose.transform.orientation) : null, performance.now());
  };
  session.requestAnimationFrame(onFrame);
  return { tracks_position: true, stop: () => void session.end().catch(() => undefined) };
}

function preventDefault(event: Event): void {
  event.preventDefault();
}

/** Give a session the layer without which it makes no frames; nothing is drawn on it. */
async function giveLayer(session: XRSession): Promise<void> {
  const gl = document.createElement("canvas").getContext("webgl", { xrCompatible: true });
  if (gl) await session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl) });
}
