import type { JSX } from "preact";
import { useContext, useEffect, useState } from "preact/hooks";
import { t } from "../texts/texts";
import { Button, Shown, usePage } from "./ui";

/** Cameras that are shown at once: each takes a share of the network. */
const MAX_TILES = 6;

/** A tile for each topic of compressed pictures. */
export function CamerasPanel(): JSX.Element {
  const { cameras, store } = usePage();
  const shown = useContext(Shown);
  const { connected } = store.state.link;
  const [topics, setTopics] = useState<string[]>([]);
  const look = async (): Promise<void> => {
    // Without a connection the next look comes with the next one.
    if (store.state.link.connected) await cameras.topics().then(setTopics, () => undefined);
  };
  useEffect(() => void (shown && look()), [shown, connected]);
  return (
    <div>
      <p class="hint" data-testid="cameras-empty" hidden={topics.length > 0}>{t("cameras.empty")}</p>
      <ul class="cameras" data-testid="cameras">{topics.slice(0, MAX_TILES).map((topic) => <Tile key={topic} topic={topic} />)}</ul>
      <Button testid="cameras-look" press={() => void look()}>{t("cameras.look")}</Button>
    </div>
  );
}

/** Tile of a camera, which asks for pictures only while it is seen. */
function Tile({ topic }: { topic: string }): JSX.Element {
  const { cameras } = usePage();
  const shown = useContext(Shown);
  const [url, setUrl] = useState<string>();
  useEffect(() => (shown ? cameras.watch(topic, setUrl) : undefined), [shown, topic]);
  return <li><img data-testid={`camera-${topic}`} alt={topic} src={url} /><span>{topic}</span></li>;
}
