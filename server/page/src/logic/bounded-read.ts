/** Reads an answer up to a limit, so that a file of any size costs no more than it; throws beyond. */
export async function readBounded(answer: Response, limit_bytes: number): Promise<Uint8Array<ArrayBuffer>> {
  const told_bytes = Number(answer.headers.get("content-length") ?? 0);
  if (told_bytes > limit_bytes) {
    await answer.body?.cancel();
    throw tooLarge(told_bytes, limit_bytes);
  }
  const reader = answer.body?.getReader();
  const chunks: Uint8Array[] = [];
  let size_bytes = 0;
  for (let part = await reader?.read(); part?.value !== undefined; part = await reader?.read()) {
    chunks.push(part.value);
    size_bytes += part.value.length;
    // A compressed file tells the size of what travels, not of what comes out.
    if (size_bytes > limit_bytes) {
      await reader?.cancel();
      throw tooLarge(size_bytes, limit_bytes);
    }
  }
  return joined(chunks, size_bytes);
}

function joined(chunks: Uint8Array[], size_bytes: number): Uint8Array<ArrayBuffer> {
  const whole = new Uint8Array(size_bytes);
  let at = 0;
  for (const chunk of chunks) {
    whole.set(chunk, at);
    at += chunk.length;
  }
  return whole;
}

function tooLarge(size_bytes: number, limit_bytes: number): Error {
  const mb = (bytes: number): string => `${Math.ceil(bytes / 1e6)} MB`;
  return new Error(`larger than the ${mb(limit_bytes)} that the page loads (${mb(size_bytes)} and more)`);
}
