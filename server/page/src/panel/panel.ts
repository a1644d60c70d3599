import { control } from "./control";
import { el } from "./dom";
import { watchGates } from "./gate";
import { goals } from "./goals";
import { gripper } from "./gripper";
import { jog } from "./jog";
import { joints } from "./joints";
import { log } from "./log";
import { notices } from "./notices";
import { objects } from "./objects";
import type { Page } from "./page";
import { plots } from "./plots";
import { scrubber } from "./scrubber";
import { servos } from "./servos";
import { status } from "./status";
import { stopButton } from "./stop-button";
import { target } from "./target";
import { themeSwitch } from "./theme";
import { tokenForm } from "./token-form";
import { waiting } from "./waiting";

type Part = (page: Page) => HTMLElement;

const PARTS: Part[] = [goals, target, joints, gripper, servos, objects, waiting, jog, plots, log, themeSwitch];

/** Put the panel into the page: STOP first and outside of everything that can hide it. */
export function panel(page: Page): void {
  document.body.append(stopButton(page));
  const host = document.querySelector("#panel") ?? document.body.appendChild(el("div", { id: "panel" }));
  host.append(status(page), tokenForm(page), control(page), notices(page));
  document.querySelector("#scene")?.append(scrubber(page));
  for (const part of PARTS) host.append(part(page));
  watchGates(page);
}
