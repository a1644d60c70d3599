import type { JSX } from "preact";
import { useContext, useEffect, useState } from "preact/hooks";
import { ask } from "../link/connection";
import { keyValues, type Received } from "../link/messages";
import { t } from "../texts/texts";
import { isTyping } from "./drive-keyboard";
import { Button, Gate, Line, Section, Select, Shown, TextList, usePage } from "./ui";

const STATUS = "diagnostic_msgs/msg/DiagnosticStatus";
const RATE = "rate_hz.";

/** As the server's. */
const MAX_TASK_CHARACTERS = 300;

/** Joint states that are the server's own or goals, and no leader's. */
const OWN_STATES = /^\/joint_states$|\/(teleop\/leader_joint_states|moveit_goal_joints)$/;

/** Return the newest message of a topic while the panel is shown, and a function that calls a service and its answer. */
function useTopic<Type extends keyof Received>(topic: string, type: Type): [Received[Type] | undefined, (service: string, request?: object) => void, string] {
  const { connection } = usePage();
  const shown = useContext(Shown);
  const [newest, take] = useState<Received[Type]>();
  const [answer, tell] = useState("");
  useEffect(() => (shown ? connection.subscribe(topic, type, (message) => take(() => message)) : undefined), [shown]);
  return [newest, (service, request = {}) => void ask(connection, service, request).then(({ message }) => tell(message)), answer];
}

/** Episodes of the server's recording, with the keys of lerobot-record: right keeps, left drops, Esc stops the arm and keeps. */
export function EpisodesSection(): JSX.Element {
  const { cameras, store } = usePage();
  const shown = useContext(Shown);
  const [status, call, answer] = useTopic("/dataset/state", STATUS);
  const [topics, setTopics] = useState<string[]>([]);
  const [task, setTask] = useState("");
  const values = status ? keyValues(status) : {};
  const in_progress = (values.episode_s ?? "") !== "";
  const keep = (): void => call("/dataset/stop_episode");
  const drop = (): void => call("/dataset/discard_episode");
  const { connected } = store.state.link;
  useEffect(() => void (shown && connected && cameras.topics().then(setTopics, () => undefined)), [shown, connected, in_progress]);
  useEffect(() => {
    if (!shown || !in_progress) return;
    const press = (event: KeyboardEvent): void => {
      // An arrow that drives the arm is no answer to an episode.
      if (event.defaultPrevented || event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
      if (event.key === "Escape" || (event.key === "ArrowRight" && !isTyping(event.target))) keep();
      if (event.key === "ArrowLeft" && !isTyping(event.target)) drop();
    };
    window.addEventListener("keydown", press);
    return () => window.removeEventListener("keydown", press);
  }, [shown, in_progress]);
  const rates = [...new Set([...topics, ...Object.keys(values).filter((key) => key.startsWith(RATE)).map((key) => key.slice(RATE.length))])];
  const seen = rates.filter((topic) => !OWN_STATES.test(topic));
  return (
    <Section name="episodes" title={t("recording.episodes")}>
      <p class="hint" data-testid="recording-off" hidden={values.recording !== "false"}>{t("recording.off")}</p>
      <Gate to="work">
        <Line text={t("recording.task")}><input type="text" data-testid="episode-task" autocomplete="off" maxlength={MAX_TASK_CHARACTERS} value={task} onInput={({ currentTarget }) => setTask(currentTarget.value)} /></Line>
        <div class="buttons">
          <Button testid="episode-start" disabled={in_progress || values.recording === "false"} press={() => call("/dataset/start_episode", { task })}>{t("recording.start")}</Button>
          <Button testid="episode-keep" disabled={!in_progress} aria-keyshortcuts="ArrowRight" press={keep}>{t("recording.keep")}</Button>
          <Button testid="episode-drop" disabled={!in_progress && (values.episodes ?? "0") === "0"} aria-keyshortcuts="ArrowLeft" press={drop}>{t("recording.drop")}</Button>
        </div>
      </Gate>
      <p data-testid="episode-count">{t("recording.count", { count: values.episodes ?? "0", lengths: (values.lengths_s ?? "").split(" ").filter(Boolean).map((length) => `${length} s`).join(", ") })}</p>
      <p data-testid="episode-now" hidden={!in_progress}>{t("recording.now", { seconds: values.episode_s ?? "", task: values.task ?? "" })}</p>
      <TextList kind="things" testid="recording-cameras" label={t("panel.cameras")} texts={seen.map((topic) => (in_progress && values[RATE + topic] ? t("recording.camera", { topic, rate: values[RATE + topic] as string }) : topic))} />
      <p role="alert" data-testid="recording-problem">{status?.message}</p>
      <p role="status" data-testid="recording-answer">{answer}</p>
      <p class="hint">{t("recording.keys")}</p>
    </Section>
  );
}

/** A leader's joint states that the arm follows. */
export function LeaderSection(): JSX.Element {
  const { connection, store } = usePage();
  const shown = useContext(Shown);
  const [state, call, answer] = useTopic("/teleop/state", "armbridge_msgs/msg/TeleopState");
  const [leaders, setLeaders] = useState<string[]>([]);
  const [chosen, choose] = useState("");
  const { connected } = store.state.link;
  const look = (): void => {
    const request = { type: "sensor_msgs/JointState" };
    void connection.call<{ topics: string[] }>("/rosapi/topics_for_type", request).then(({ topics }) => setLeaders(topics.filter((topic) => !OWN_STATES.test(topic))), () => undefined);
  };
  useEffect(() => void (shown && connected && look()), [shown, connected]);
  const leader = leaders.includes(chosen) ? chosen : (leaders[0] ?? "");
  const follows = state !== undefined && state.phase !== "idle";
  return (
    <Section name="leader" title={t("recording.leader")}>
      <Gate to="drive">
        <div class="buttons">
          {leader !== "" && <Select testid="leader-topic" label={t("recording.leader")} value={leader} options={leaders.map((topic) => [topic, topic] as const)} take={choose} disabled={follows} />}
          <Button testid="leader-look" press={look}>{t("recording.leader.look")}</Button>
          <Button testid="leader-on" hidden={follows} disabled={leader === ""} press={() => call("/teleop/start", { follower: "", leader })}>{t("recording.leader.on")}</Button>
          <Button testid="leader-off" hidden={!follows} press={() => call("/teleop/stop")}>{t("recording.leader.off")}</Button>
        </div>
      </Gate>
      <p role="status" data-testid="leader-state">{answer || state?.message}</p>
    </Section>
  );
}

/** A learned policy that moves the arm: its state, pause, and stop. */
export function PolicySection(): JSX.Element {
  const [status, call] = useTopic("/arm/chunks/state", STATUS);
  const phase = status ? keyValues(status).phase : "idle";
  const held = phase === "paused" || phase === "taken_over";
  return (
    <Section name="policy" title={t("recording.policy")}>
      <p role="status" data-testid="policy-state" data-phase={phase}>{status?.message}</p>
      <div class="buttons">
        <Gate to="work"><Button testid="policy-pause" hidden={held} press={() => call("/arm/chunks/pause")}>{t("recording.policy.pause")}</Button></Gate>
        <Gate to="drive"><Button testid="policy-resume" hidden={!held} press={() => call("/arm/chunks/resume")}>{t("recording.policy.resume")}</Button></Gate>
        <Button testid="policy-stop" press={() => call("/arm/chunks/stop")}>{t("recording.policy.stop")}</Button>
      </div>
    </Section>
  );
}
