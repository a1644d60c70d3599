import type { JSX } from "preact";
import { useContext, useEffect, useRef, useState } from "preact/hooks";
import { poseKey } from "../logic/sequence";
import { NO_GOAL, type StudentArm } from "../state/state";
import { t } from "../texts/texts";
import { statePill } from "./status";
import { Button, Gate, Shown, usePage } from "./ui";

export function ClassroomPanel(): JSX.Element {
  const { classroom, store: { state } } = usePage();
  const shown = useContext(Shown);
  const is_teacher = state.identity?.role === "admin";
  const names = state.classroom.map(({ name }) => name).join();
  useEffect(() => (shown && is_teacher && names !== "" ? classroom.watch() : undefined), [shown, is_teacher, names]);
  return (
    <div>
      <p class="hint" data-testid="class-hint">{t(is_teacher ? "class.hint" : "class.teacher")}</p>
      <ul class="cameras class" data-testid="class">{is_teacher && state.classroom.map((student) => <Tile key={student.name} {...student} />)}</ul>
    </div>
  );
}

function Tile({ name, connected, arm, seen_rad }: StudentArm): JSX.Element {
  const { classroom, store: { state } } = usePage();
  const [answer, tell] = useState("");
  // The picture before stays until the next one is drawn.
  const picture = useRef<string | undefined>(undefined);
  picture.current = state.thumbnails[poseKey(seen_rad)] ?? picture.current;
  const link = { ...state.link, connected, refused: "" };
  const { label, kind } = statePill({ ...state, link, arm: arm ?? { ...state.arm, mode: "" }, goal: NO_GOAL, pending_request: "nothing" });
  return (
    <li data-testid={`class-${name}`}>
      <img class="thumbnail" alt={name} src={picture.current} hidden={picture.current === undefined} />
      <b>{name}</b> <span class="pill" data-testid={`class-${name}-state`} data-kind={kind} title={arm?.message}>{label}</span>
      <div class="buttons">
        <Button class="stop-one" testid={`class-${name}-stop`} aria-label={`${t("stop.word")}: ${name}`} disabled={!connected} press={() => void classroom.stop(name).then(tell)}>{t("stop.word")}</Button>
        <Gate to="configure"><Button testid={`class-${name}-reset`} aria-label={`${t("class.reset")}: ${name}`} disabled={!connected} press={() => void classroom.reset(name).then(tell)}>{t("class.reset")}</Button></Gate>
      </div>
      <small class="hint" role="status">{answer}</small>
    </li>
  );
}
