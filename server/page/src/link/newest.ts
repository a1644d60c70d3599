/** Asks one question at a time, and after it only the newest of those that came meanwhile. */
export class Newest<Question> {
  private busy = false;
  private next: { question: Question } | null = null;

  /** @param ask - asks, and takes the answer in; must not reject. */
  constructor(private readonly ask: (question: Question) => Promise<void>) {}

  /** Whether a newer question than the one that is being answered waits. */
  get overtaken(): boolean {
    return this.next !== null;
  }

  /** Ask, now or when the present question is answered. */
  put(question: Question): void {
    this.next = { question };
    if (!this.busy) void this.work();
  }

  private async work(): Promise<void> {
    this.busy = true;
    while (this.next) {
      const { question } = this.next;
      this.next = null;
      await this.ask(question);
    }
    this.busy = false;
  }
}
