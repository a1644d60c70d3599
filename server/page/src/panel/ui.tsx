import { effect, untracked, useSignal, type Signal } from "@preact/signals";
import { createContext, type ComponentChildren, type JSX } from "preact";
import { useContext, useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { denialReason, type Operation } from "../logic/permissions";
import type { NumberRange } from "../logic/numbers";
import { throttle } from "../logic/throttle";
import { loadPreference, storePreference } from "../state/preferences";
import type { State } from "../state/state";
import { t } from "../texts/texts";
import type { PanelContext } from "./context";
import { NumberEntry } from "./number-entry";

/** Services of the page. */
export const Page = createContext({} as PanelContext);
export const usePage = (): PanelContext => useContext(Page);

/** True while what is inside can be seen: its panel is open, and no section above it is closed. */
export const Shown = createContext(true);

/** Return the state, at most once a period, and only while the component can be seen. */
export function useSlowState(period_ms: number): State {
  const { store } = usePage();
  const shown = useContext(Shown);
  const [state, take] = useState(() => untracked(() => ({ ...store.state })));
  useEffect(() => {
    if (!shown) return;
    const takeSometimes = throttle(period_ms, take);
    return effect(() => takeSometimes({ ...store.state }));
  }, [shown]);
  return state;
}

/** Reason for which an operation is not possible at the moment; empty when it is. */
export function useDenial(operation: Operation): string {
  const { state } = usePage().store;
  return state.link.connected ? denialReason(operation, state) : t("bar.offline.disabled");
}

/** Controls that are disabled while the server would deny their operation. */
export function Gate({ to, hidden, children }: { to: Operation; hidden?: boolean; children: ComponentChildren }): JSX.Element {
  const reason = useDenial(to);
  return <fieldset class="gate" disabled={reason !== ""} title={reason} hidden={hidden}>{children}</fieldset>;
}

type ButtonProps = Omit<JSX.IntrinsicElements["button"], "onClick"> & { testid: string; press: () => void };

export function Button({ testid, press, ...rest }: ButtonProps): JSX.Element {
  return <button type="button" data-testid={testid} onClick={press} {...rest} />;
}

/** Button with one sign, whose name is its title. */
export function SignButton({ sign, label, ...rest }: ButtonProps & { sign: ComponentChildren; label: string }): JSX.Element {
  return <Button title={label} aria-label={label} {...rest}>{sign}</Button>;
}

/** Button that deletes something at its second press: the first one asks, until the button loses the focus. */
export function DeleteButton({ testid, name, text, remove }: { testid: string; name: string; text: string; remove: () => void }): JSX.Element {
  const [asking, ask] = useState(false);
  const press = ({ detail }: MouseEvent): void => {
    // The second click of a double click is no answer.
    if (detail > 1) return;
    if (asking) remove();
    ask(!asking);
  };
  return (
    <button type="button" data-testid={testid} class={asking ? "asking" : ""} aria-label={`${t("ask.label")}: ${name}`} onClick={press} onBlur={() => ask(false)}>
      {asking ? t("ask.delete") : text}
    </button>
  );
}

interface NameFormProps {
  testid: string;
  label: string;
  /** Text and test id of the button that submits. */
  button: string;
  button_testid: string;
  title?: string;
  /** Takes the name; one that it returns true for is cleared. */
  submit: (name: string) => boolean | Promise<boolean>;
}

export function NameForm({ testid, label, button, button_testid, title, submit }: NameFormProps): JSX.Element {
  const input = useRef<HTMLInputElement>(null);
  const send = async (): Promise<void> => {
    const name = input.current;
    const typed = name?.value.trim() ?? "";
    if (typed === "") name?.focus();
    if ((await submit(typed)) && name) name.value = "";
  };
  return (
    <div class="save-scene">
      <label>{label}<input ref={input} type="text" data-testid={testid} autocomplete="off" maxlength={50} onKeyDown={({ key }) => key === "Enter" && void send()} /></label>
      <Button testid={button_testid} title={title} press={() => void send()}>{button}</Button>
    </div>
  );
}

/** Icon from a path in a square of 24. */
export function Icon({ path }: { path: string }): JSX.Element {
  return <svg viewBox="0 0 24 24" class="icon" aria-hidden="true"><path d={path} /></svg>;
}

/** Line with a text before its control. */
export function Line({ text, children }: { text: string; children: ComponentChildren }): JSX.Element {
  return <label class="line">{text} {children}</label>;
}

interface SelectProps {
  testid: string;
  label?: string;
  value: string;
  /** Values with their texts. */
  options: readonly (readonly [string, string])[];
  take: (value: string) => void;
  disabled?: boolean;
}

export function Select({ options, take, testid, label, ...rest }: SelectProps): JSX.Element {
  return (
    <select data-testid={testid} aria-label={label} onChange={({ currentTarget }) => take(currentTarget.value)} {...rest}>
      {options.map(([value, text]) => <option key={value} value={value}>{text}</option>)}
    </select>
  );
}

/** Box to tick, with a text behind it. */
export function Tick({ testid, text, checked, take, kind = "line" }: { testid: string; text: ComponentChildren; checked: boolean; take: (on: boolean) => void; kind?: "line" | "choice" }): JSX.Element {
  return <label class={kind}><input type="checkbox" data-testid={testid} checked={checked} onChange={({ currentTarget }) => take(currentTarget.checked)} />{text}</label>;
}

/** Choices of which one is taken, in a row. */
export function Radios({ name, label, value, options, take, testid }: SelectProps & { name: string }): JSX.Element {
  return (
    <div class="chips" role="radiogroup" aria-label={label}>
      {options.map(([option, text]) => (
        <label key={option} class="choice"><input type="radio" name={name} data-testid={`${testid}-${option}`} checked={option === value} onChange={() => take(option)} />{text}</label>
      ))}
    </div>
  );
}

/** Texts as a list, which is hidden without any. */
export function TextList({ texts, testid, label, kind }: { texts: readonly string[]; testid: string; label?: string; kind: string }): JSX.Element {
  return <ul class={kind} data-testid={testid} aria-label={label} hidden={texts.length === 0}>{texts.map((text, index) => <li key={index}>{text}</li>)}</ul>;
}

/** Collapsible section of a panel; the browser stores its open state. */
export function Section({ name, title, open = true, hidden, children }: { name: string; title: string; open?: boolean; hidden?: boolean; children: ComponentChildren }): JSX.Element {
  const shown = useContext(Shown);
  const [is_open, setOpen] = useState(() => loadPreference(`open-${name}`, String(open)) === "true");
  const toggle = ({ currentTarget }: { currentTarget: HTMLDetailsElement }): void => {
    setOpen(currentTarget.open);
    storePreference(`open-${name}`, String(currentTarget.open));
  };
  return (
    <details class="section" id={`section-${name}`} data-testid={`section-${name}`} open={is_open} hidden={hidden} onToggle={toggle}>
      <summary>{title}</summary>
      <Shown.Provider value={shown && is_open}>{children}</Shown.Provider>
    </details>
  );
}

const ProblemsOf = createContext<Signal<Record<string, string>> | null>(null);

/** Place below number fields for the problems of what is typed in them. */
export function Problems({ children }: { children: ComponentChildren }): JSX.Element {
  const problems = useSignal<Record<string, string>>({});
  return (
    <ProblemsOf.Provider value={problems}>
      {children}
      <ProblemTexts problems={problems} />
    </ProblemsOf.Provider>
  );
}

function ProblemTexts({ problems }: { problems: Signal<Record<string, string>> }): JSX.Element {
  return <>{Object.entries(problems.value).map(([testid, text]) => <small key={testid} class="problem" data-testid={`${testid}-problem`} role="alert">{text}</small>)}</>;
}

/** Input for a number within Problems. */
export function NumberField({ testid, label, range, text, take }: { testid: string; label: string; range: NumberRange; text: string; take: (value: number) => void }): JSX.Element {
  const problems = useContext(ProblemsOf);
  const report = (problem: string): void => {
    if (problems) problems.value = { ...problems.peek(), [testid]: problem };
  };
  const newest = useRef({ range, take, report });
  newest.current = { range, take, report };
  const input = useRef<HTMLInputElement>(null);
  const entry = useRef<NumberEntry | null>(null);
  useLayoutEffect(() => {
    if (input.current) entry.current ??= new NumberEntry(input.current, () => newest.current);
    entry.current?.show(text);
  }, [text]);
  // A screen reader speaks an alert whose element was there before.
  useEffect(() => report(""), []);
  return <input ref={input} type="text" class="number" data-testid={testid} aria-label={label} inputmode="decimal" autocomplete="off" spellcheck={false} />;
}
