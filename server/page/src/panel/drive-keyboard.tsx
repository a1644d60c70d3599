import type { JSX } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { GRIPPER_KEYS, jointKeys, keyCommand, printedKey, tipAxes, tipKeys, type KeyPair } from "../logic/jog";
import { armGripper, armJoints } from "../logic/joints";
import { t } from "../texts/texts";
import { axisText, useControls } from "./drive-controls";
import { Gate, Section, usePage } from "./ui";

/** Driving by the keyboard, which moves nothing until the user switches it on. */
export function KeyboardSection(): JSX.Element {
  const { store, jogSender } = usePage();
  const controls = useControls();
  const on = useRef<HTMLInputElement>(null);
  const [held, setHeld] = useState<readonly string[]>([]);
  useEffect(() => {
    const press = (event: KeyboardEvent): void => {
      if (!on.current?.checked || isTyping(event.target) || event.ctrlKey || event.altKey || event.metaKey) return;
      const joints = armJoints(store.state);
      const command = keyCommand(event.code, tipAxes(joints.length), joints);
      if (command === null) return;
      event.preventDefault();
      if (event.repeat) return;
      controls.press(`key ${event.code}`, command);
      setHeld((codes) => [...codes, event.code]);
    };
    const release = ({ code }: KeyboardEvent): void => {
      controls.release(`key ${code}`);
      setHeld((codes) => (codes.includes(code) ? codes.filter((each) => each !== code) : codes));
    };
    window.addEventListener("keydown", press);
    window.addEventListener("keyup", release);
  }, []);
  const joints = armJoints(store.state);
  const line = (name: string, keys: KeyPair | null): JSX.Element => (
    <div key={name}><span>{name}</span>{keys?.map((code) => <kbd key={code} data-code={code} data-held={held.includes(code) ? "" : undefined}>{printedKey(code)}</kbd>)}</div>
  );
  return (
    <Section name="drive-keys" title={t("drive.keys")} open={false}>
      <label class="line"><Gate to="drive"><input ref={on} type="checkbox" data-testid="jog" onChange={() => jogSender.releaseAll()} /></Gate>{t("drive.keys.on")}</label>
      <div class="key-legend" data-testid="key-legend">
        {tipAxes(joints.length).map((axis) => line(axisText(axis), tipKeys(axis)))}
        {armGripper(store.state) && line(t("drive.gripper"), GRIPPER_KEYS)}
        {joints.map((name, index) => line(name, jointKeys(index)))}
      </div>
      <p class="hint">{t("drive.keys.hint")}</p>
    </Section>
  );
}

/** Return true for an element that uses keys itself. */
export function isTyping(target: EventTarget | null): boolean {
  if (!(target instanceof HTMLElement)) return false;
  if (target instanceof HTMLInputElement) return target.type !== "checkbox";
  return target.isContentEditable || target.matches("select, textarea, [role=tab]");
}
