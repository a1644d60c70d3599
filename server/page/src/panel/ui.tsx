import { effect, untracked, useSignal, type Signal } from "@preact/signals";
import { createContext, type ComponentChildren, type JSX, type RefObject } from "preact";
import { useContext, useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import type { Services } from "../link/services";
import { denialReason, immobility, type Operation } from "../logic/permissions";
import { parseNumber, positionText, unitOf, type NumberRange } from "../logic/numbers";
import { throttle } from "../logic/throttle";
import { loadPreference, storePreference } from "../state/preferences";
import type { State } from "../state/state";
import { t } from "../texts/texts";

export const Page = createContext({} as Services);
export const usePage = (): Services => useContext(Page);

/** True while what is inside can be seen: its panel is open, and no section above it is closed. */
export const Shown = createContext(true);

/** Least time between two updates of numbers and lists [ms]; faster ones cannot be read. */
const READABLE_PERIOD_MS = 200;

/** Return the state, at most once a period, and only while the component can be seen. */
export function useSlowState(): State {
  return useSlowPart((state) => ({ ...state }));
}

/** Return a part of the state, which draws the component again only where it is another one; else as useSlowState. */
export function useSlowPart<Part>(select: (state: State) => Part): Part {
  const { store } = usePage();
  const shown = useContext(Shown);
  const [part, take] = useState(() => untracked(() => select(store.state)));
  useEffect(() => {
    if (!shown) return;
    const takeSometimes = throttle<Part>(READABLE_PERIOD_MS, (newest) => take(() => newest));
    return effect(() => takeSometimes(select(store.state)));
  }, [shown]);
  return part;
}

/** Controls that are disabled while the server would deny their operation, or the arm could not make their motion. */
export function Gate({ to, moves, hidden, children }: { to: Operation; moves?: boolean; hidden?: boolean; children: ComponentChildren }): JSX.Element {
  const { state } = usePage().store;
  const reason = state.link.connected ? denialReason(to, state) || (moves ? immobility(state) : "") : t("bar.offline.disabled");
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

export function Icon({ path }: { path: string }): JSX.Element {
  return <svg viewBox="0 0 24 24" class="icon" aria-hidden="true"><path d={path} /></svg>;
}

export function Line({ text, children }: { text: string; children: ComponentChildren }): JSX.Element {
  return <label class="line">{text} {children}</label>;
}

interface SelectProps {
  testid: string;
  label?: string;
  value: string;
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

export function Tick({ testid, text, checked, take, kind = "line" }: { testid: string; text: ComponentChildren; checked: boolean; take: (on: boolean) => void; kind?: "line" | "choice" }): JSX.Element {
  return <label class={kind}><input type="checkbox" data-testid={testid} checked={checked} onChange={({ currentTarget }) => take(currentTarget.checked)} />{text}</label>;
}

export function Radios({ label, value, options, take, testid, titled = false }: SelectProps & { titled?: boolean }): JSX.Element {
  return (
    <div class="chips" role="radiogroup" aria-label={label}>
      {titled && <span class="measures-title">{label}</span>}
      {options.map(([option, text]) => (
        <label key={option} class="choice"><input type="radio" name={testid} data-testid={`${testid}-${option}`} checked={option === value} onChange={() => take(option)} />{text}</label>
      ))}
    </div>
  );
}

export function TextList({ texts, testid, label, kind }: { texts: readonly string[]; testid: string; label?: string; kind: string }): JSX.Element {
  return <ul class={kind} data-testid={testid} aria-label={label} hidden={texts.length === 0}>{texts.map((text, index) => <li key={index}>{text}</li>)}</ul>;
}

/** Collapsible section of a panel, which opens by itself when it is forced to; the browser stores its open state. */
export function Section({ name, title, open = true, force = false, hidden, children }: { name: string; title: string; open?: boolean; force?: boolean; hidden?: boolean; children: ComponentChildren }): JSX.Element {
  const shown = useContext(Shown);
  const [is_open, setOpen] = useState(() => loadPreference(`open-${name}`, String(open)) === "true");
  useEffect(() => void (force && setOpen(true)), [force]);
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

/** Input for a number within Problems: clamped to its limits, reverted when it is invalid, with a message for either. */
export function NumberField({ testid, label, range, text, take }: { testid: string; label: string; range: NumberRange; text: string; take: (value: number) => void }): JSX.Element {
  const problems = useContext(ProblemsOf);
  const report = (problem: string): void => {
    if (problems) problems.value = { ...problems.peek(), [testid]: problem };
  };
  // Text while the field has the focus: another one would end the user's selection. Null shows the newest value.
  const [kept, keep] = useState<string | null>(null);
  const edited = useRef(false);
  const commit = (input: HTMLInputElement): void => {
    // Enter and, after it, the browser's change come for one text.
    if (!edited.current) return;
    edited.current = false;
    const { value, message } = parseNumber(input.value, range);
    report(message);
    keep(value === null ? text : String(Number(value.toFixed(range.digits))));
    if (value !== null) take(value);
  };
  const edit = ({ currentTarget }: { currentTarget: HTMLInputElement }): void => {
    edited.current = true;
    keep(currentTarget.value);
    report("");
  };
  // A screen reader speaks an alert whose element was there before.
  useEffect(() => report(""), []);
  return (
    <input
      type="text" class="number" data-testid={testid} aria-label={label} inputmode="decimal" autocomplete="off" spellcheck={false} value={kept ?? text}
      onFocus={() => keep(text)} onInput={edit} onChange={({ currentTarget }) => commit(currentTarget)} onKeyDown={({ key, currentTarget }) => key === "Enter" && commit(currentTarget)} onBlur={() => keep(null)}
    />
  );
}

interface SliderProps {
  testid: string;
  label?: string;
  /** Least and largest value, and step. */
  range: readonly [number, number, number];
  value: number;
  take?: (value: number) => void;
  /** Takes the value at which the slider is let go. */
  release?: (value: number) => void;
  /** Selector of a slider that keeps its place whatever the value is. */
  busy?: string;
  dir?: "ltr" | "rtl";
  id?: string;
}

export function Slider({ testid, label, range: [min, max, step], value, take, release, busy = ":active", ...rest }: SliderProps): JSX.Element {
  const slider = useRef<HTMLInputElement>(null);
  useLayoutEffect(() => {
    const { current } = slider;
    if (current === null || !Number.isFinite(value) || current.matches(busy)) return;
    if (Math.abs(Number(current.value) - value) > step / 2) current.value = String(value);
  });
  return (
    <input
      ref={slider} type="range" data-testid={testid} aria-label={label} min={min} max={max} step={step} {...rest}
      onInput={({ currentTarget }) => take?.(Number(currentTarget.value))} onChange={({ currentTarget }) => release?.(Number(currentTarget.value))}
    />
  );
}

export function FileInput({ testid, label, take }: { testid: string; label: string; take: (file: File) => Promise<void> }): JSX.Element {
  const open = (input: HTMLInputElement): void => {
    const file = input.files?.[0];
    // The same file can be chosen again.
    if (file) void take(file).finally(() => void (input.value = ""));
  };
  return <label class="scene-upload">{label}<input type="file" data-testid={testid} accept=".json,application/json" onChange={({ currentTarget }) => open(currentTarget)} /></label>;
}

/** Return a reference to a list whose elements keep the focus when they are moved. */
export function useKeptFocus<Element extends HTMLElement>(): RefObject<Element | null> {
  const list = useRef<Element>(null);
  const focused = document.activeElement;
  useLayoutEffect(() => {
    if (focused instanceof HTMLElement && focused !== document.activeElement && list.current?.contains(focused)) focused.focus();
  });
  return list;
}

/** Input for a text, which is taken when it is entered or left; what is being typed outlives updates. */
export function TextField({ testid, label, value, maxlength, take }: { testid: string; label?: string; value: string; maxlength?: number; take: (text: string) => void }): JSX.Element {
  const [typed, type] = useState<string | null>(null);
  const commit = (text: string): void => {
    type(null);
    take(text.trim());
  };
  return (
    <input
      type="text" data-testid={testid} aria-label={label} maxlength={maxlength} autocomplete="off" spellcheck={false} value={typed ?? value}
      onInput={({ currentTarget }) => type(currentTarget.value)} onChange={({ currentTarget }) => commit(currentTarget.value)}
    />
  );
}

interface MeasureProps {
  testid: string;
  /** "prismatic" for a length, "revolute" for an angle, as joints have them. */
  kind?: "prismatic" | "revolute";
  name: string;
  /** Label for screen readers, as "Size x". */
  label?: string;
  /** Limits [m or rad]. */
  lower: number;
  upper: number;
  value: number;
  take: (value: number) => void;
}

/** Field within Problems for a length or an angle, labelled with its name and the unit that the user has chosen. */
export function MeasureField({ testid, kind = "prismatic", name, label = name, lower, upper, value, take }: MeasureProps): JSX.Element {
  const unit = unitOf(kind, usePage().store.state.settings.units);
  const { scale, suffix, digits } = unit;
  const text = positionText(value, unit);
  return (
    <label class="measure">
      <span>{`${name} (${suffix.trim()})`}</span>
      <NumberField
        testid={testid} label={`${label} (${suffix.trim()})`} range={{ name: label, lower: lower * scale, upper: upper * scale, unit: suffix, digits }}
        // Without zeros after the last decimal.
        text={text.includes(".") ? text.replace(/\.?0+$/, "") : text} take={(typed) => take(typed / unit.scale)}
      />
    </label>
  );
}

/** Line of fields with its title, and their problems below. */
export function MeasureLine({ title, children }: { title: string; children: ComponentChildren }): JSX.Element {
  return <div><Problems><div class="measures" role="group" aria-label={title}><span class="measures-title">{title}</span>{children}</div></Problems></div>;
}
