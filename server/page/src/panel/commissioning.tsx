import type { JSX } from "preact";
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { droopText, procedureTitle, questionOf, rangeBar, rangeText, type BarPart } from "../logic/commissioning";
import { openPanel } from "../logic/layout";
import { denialReason } from "../logic/permissions";
import type { Commissioning, SweptJoint } from "../state/state";
import { selectGoal } from "../state/store";
import { capitalized, t } from "../texts/texts";
import { Button, Gate, Line, Section, TextList, usePage } from "./ui";

/** Time for which new answers cannot be pressed [ms]: the second click of a double click must not answer what comes next. */
const ARMING_MS = 400;

/** Bar of a procedure in progress, with its cancel; it belongs where nothing scrolls it away. */
export function ProcedureBar(): JSX.Element {
  const { store, commissioning: commands } = usePage();
  const { commissioning } = store.state;
  return (
    <div class="procedure" hidden={!isInProgress(commissioning)}>
      <span data-testid="procedure" role="status">{commissioning && t("commissioning.in_progress", { procedure: procedureTitle(commissioning.procedure) })}</span>
      <progress data-testid="procedure-progress" aria-label={t("commissioning.progress")} value={commissioning?.progress ?? 0} />
      <Gate to="configure"><Button testid="procedure-cancel" title={t("commissioning.cancel.hint")} press={() => void commands.request("cancel")}>{t("commissioning.cancel")}</Button></Gate>
    </div>
  );
}

export function CommissioningSection(): JSX.Element {
  const { store } = usePage();
  const { commissioning } = store.state;
  const in_progress = isInProgress(commissioning);
  const denied = denialReason("commission", store.state);
  useEffect(() => {
    if (!in_progress) return;
    store.set({ layout: openPanel(store.state.layout, "arm") });
    // The ghost of a goal would stand beside the model that is to be compared with the arm.
    if (store.state.selection.kind !== "none") selectGoal(store, "none", null);
  }, [in_progress]);
  return (
    <Section name="commissioning" title={t("commissioning.title")} open={false} force={in_progress} hidden={commissioning === null}>
      <p class="hint" data-testid="commissioning-reason" hidden={denied === ""}>{denied}</p>
      <div hidden={in_progress}><Begin /></div>
      {commissioning && <div class="step" hidden={!in_progress}><Step commissioning={commissioning} /></div>}
      <ul class="sweep" data-testid="swept-joints" aria-label={t("commissioning.joints")} hidden={!commissioning?.joints.length}>
        {commissioning?.joints.map((joint) => <JointBar key={joint.joint} joint={joint} />)}
      </ul>
      <TextList kind="findings" testid="findings" label={t("commissioning.findings")} texts={commissioning?.findings ?? []} />
      <p class="result" data-testid="procedure-result" role="status">{in_progress ? "" : capitalized(commissioning?.result ?? "")}</p>
    </Section>
  );
}

function isInProgress(commissioning: Commissioning | null): boolean {
  return commissioning !== null && commissioning.procedure !== "";
}

function Begin(): JSX.Element {
  const { commissioning: commands } = usePage();
  const name = useRef<HTMLInputElement>(null);
  const [asking, ask] = useState(false);
  const begin = (procedure: "calibrate" | "verify"): void => {
    ask(true);
    void commands.request("begin", { procedure, name: name.current?.value.trim() ?? "" }).then(() => ask(false));
  };
  return (
    <Gate to="commission">
      <p class="hint">{t("commissioning.hint")}</p>
      <Line text={t("commissioning.calibration")}>
        <input ref={name} type="text" data-testid="calibration-name" aria-label={t("commissioning.name")} autocomplete="off" spellcheck={false} maxlength={100} placeholder={t("commissioning.name.default")} />
      </Line>
      <div class="buttons">
        <Button testid="calibrate" title={t("commissioning.calibrate.hint")} disabled={asking} press={() => begin("calibrate")}>{t("commissioning.calibrate")}</Button>
        <Button testid="verify" title={t("commissioning.verify.hint")} disabled={asking} press={() => begin("verify")}>{t("commissioning.verify")}</Button>
      </div>
    </Gate>
  );
}

/** Present step with its answers, which cannot be pressed before a person can have read them. */
function Step({ commissioning }: { commissioning: Commissioning }): JSX.Element {
  const { store, commissioning: commands } = usePage();
  const instruction = useRef<HTMLParagraphElement>(null);
  const answers = useRef<HTMLDivElement>(null);
  const [armed, arm] = useState(false);
  const question = questionOf(commissioning);
  const newest = useRef(question);
  newest.current = question;
  const had_focus = answers.current?.contains(document.activeElement) ?? false;
  useLayoutEffect(() => {
    arm(false);
    if (had_focus) instruction.current?.focus();
    // Not for those who only look on. The frame after this has the section open.
    if (commissioning.step !== "" && !denialReason("commission", store.state)) requestAnimationFrame(() => instruction.current?.parentElement?.scrollIntoView({ block: "nearest" }));
    const timer = setTimeout(() => arm(true), ARMING_MS);
    return () => clearTimeout(timer);
  }, [question]);
  const press = (answer: string): void => {
    // Before the buttons are disabled, which would send the focus to the beginning of the page.
    instruction.current?.focus();
    arm(false);
    // A new question has answers of its own by then.
    void commands.request("answer", { step: commissioning.step, answer }).then(() => newest.current === question && arm(true));
  };
  return (
    <>
      {/* Focusable, so that the keyboard is led from an answer to what is asked next. */}
      <p ref={instruction} class="instruction" data-testid="instruction" tabindex={-1} aria-live="assertive">{commissioning.instruction}</p>
      <Gate to="commission">
        <div ref={answers} class="buttons" data-testid="answers" role="group" aria-label={t("commissioning.answers")}>
          {commissioning.answers.map((answer, index) => (
            <Button key={`${commissioning.step} ${answer}`} testid={`answer-${index}`} disabled={!armed} press={() => press(answer)}>{capitalized(answer)}</Button>
          ))}
        </div>
      </Gate>
    </>
  );
}

function JointBar({ joint }: { joint: SweptJoint }): JSX.Element {
  const { joint: name, done, lowest, present, highest, expected_width } = joint;
  const in_hand = usePage().store.state.joint_in_hand?.joint === name;
  const shown = rangeBar(joint);
  // A verification moves joints without measuring their ranges.
  const has_range = expected_width > 0 || highest > lowest;
  const text = rangeText(joint);
  return (
    <li data-testid={`swept-${name}`} data-in-hand={String(in_hand)}>
      <div class="row-head">
        <b>{name}</b>
        <span class="measured" data-testid={`swept-${name}-text`} hidden={!has_range}>{text}</span>
        <span class="measured" data-testid={`swept-${name}-droop`}>{droopText(joint.droop_rad)}</span>
        <span class="tick" data-testid={`swept-${name}-done`}>{done ? `✓ ${t("commissioning.done")}` : ""}</span>
      </div>
      <div
        class="bar" role="meter" hidden={!has_range} aria-label={t("commissioning.range", { joint: name })} aria-valuemin={0} aria-valuemax={Math.max(expected_width, highest - lowest)}
        aria-valuenow={highest - lowest} aria-valuetext={done ? `${text}, ${t("commissioning.done")}` : text}
      >
        <i class="swept" style={placed(shown.swept)} />
        <i class="expected" hidden={shown.expected === null} style={placed(shown.expected ?? { begin: 0, width: 0 })} />
        <i class="present" style={placed({ begin: shown.present, width: 0 })} />
      </div>
      <span class="limits" data-testid={`swept-${name}-ticks`} title={t("commissioning.ticks")} hidden={!has_range}>{`${lowest} … ${present} … ${highest}`}</span>
      <small class="hint" data-testid={`swept-${name}-note`}>{joint.note}</small>
    </li>
  );
}

function placed({ begin, width }: BarPart): { left: string; width: string } {
  return { left: `${100 * begin}%`, width: `${100 * width}%` };
}
