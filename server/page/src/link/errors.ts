/** Why the server could not be asked, or did not answer; the message is for people. */
export class LinkError extends Error {
  override readonly name = "LinkError";
}
