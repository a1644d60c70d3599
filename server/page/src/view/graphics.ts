const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** A canvas, and what draws on it. */
export interface Graphics {
  canvas: HTMLCanvasElement;
  context: WebGL2RenderingContext;
}

/**
 * Readies a canvas for drawing: with smooth edges where a graphics card draws, plain where the processor does.
 *
 * Smooth edges cost the processor a third of its frames. Which one it is can be asked of a context alone, and a context
 * in software is dear to make, so that one is kept; on a graphics card the canvas is replaced by one like it.
 *
 * @throws Error when the browser has no WebGL.
 */
export function openGraphics(canvas: HTMLCanvasElement): Graphics {
  const plain = contextOf(canvas, false);
  if (SOFTWARE.test(rendererName(plain))) return { canvas, context: plain };
  const smooth = canvas.cloneNode(false) as HTMLCanvasElement;
  canvas.replaceWith(smooth);
  plain.getExtension("WEBGL_lose_context")?.loseContext();
  return { canvas: smooth, context: contextOf(smooth, true) };
}

function contextOf(canvas: HTMLCanvasElement, antialias: boolean): WebGL2RenderingContext {
  // Without an alpha channel the browser need not blend the picture with the page.
  const context = canvas.getContext("webgl2", { alpha: false, depth: true, stencil: false, antialias });
  if (context === null) throw new Error("the browser gives no WebGL 2");
  return context;
}

function rendererName(context: WebGL2RenderingContext): string {
  const names = context.getExtension("WEBGL_debug_renderer_info");
  return String(context.getParameter(names?.UNMASKED_RENDERER_WEBGL ?? context.RENDERER));
}
