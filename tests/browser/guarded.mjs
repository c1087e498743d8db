// A daemon that wants a token: what is told without it, and with it a capture that is scheduled, and one that is stopped.

import { Visit } from "./browser.mjs";
import { heading, moves, said, settled, start, stop } from "./live.mjs";

/// Where the person is: begin at is the time of the person's clock, whatever the daemon's.
const ZONE = "America/St_Johns";

export async function guarded(browser, checks, address, token, pid) {
  const visit = await Visit.begin(browser, checks, { timezoneId: ZONE });
  const page = await visit.page();
  await page.goto(address);
  await heading(page, "The sensor sends, nothing is recorded.");
  await checks.page(page, "first-guarded");

  visit.expected.add("401 /v1/captures");
  await start(page, { name: "refused", duration: "1h" });
  await said(page, "token");
  checks.that("token", await page.locator(".said.alarm").isVisible(), "a refusal is not told as one");
  await heading(page, "The sensor sends, nothing is recorded.");
  checks.same("token", (await captures(page)).length, 0, "captures begun without the token");
  await checks.page(page, "first-refused");

  await page.getByLabel("token").fill(token);
  visit.expected.clear();
  await scheduled(page, checks, visit);
  await recorded(page, checks, visit);
  if (pid) await lost(page, checks, visit, pid);
  await visit.end();
}

async function captures(page) {
  return page.evaluate(async () => (await (await fetch("/v1/captures")).json()).captures);
}

/// A capture of tomorrow waits for its time, and is called off.
async function scheduled(page, checks, visit) {
  const at = await page.evaluate(() => {
    const tomorrow = new Date(Date.now() + 86_400_000);
    const part = (value) => String(value).padStart(2, "0");
    const date = [tomorrow.getFullYear(), part(tomorrow.getMonth() + 1), part(tomorrow.getDate())].join("-");
    return { local: `${date}T21:30`, utc: new Date(`${date}T21:30`).toISOString() };
  });
  await start(page, { name: "tomorrow", duration: "1h", at: at.local });
  await heading(page, "Waiting to record tomorrow.");
  const [waiting] = await captures(page);
  checks.same("schedule", waiting.state, "waiting", "the capture of tomorrow");
  const told = await page.evaluate(async (id) => (await fetch(`/v1/captures/${id}`)).json(), waiting.id);
  const begins = Object.values(told).concat(Object.values(told.configuration ?? {})).filter((value) => typeof value === "string");
  checks.that("schedule", begins.some((value) => Date.parse(value) === Date.parse(at.utc)), `${at.utc} is not in ${JSON.stringify(told)}`);
  await checks.page(page, "first-waiting");
  await stop(page, visit, "Stop the capture?");
  await heading(page, "The sensor sends, nothing is recorded.");
  checks.that("schedule", (await captures(page))[0]?.state !== "waiting", "the capture that was called off waits all the same");
}

/// A capture in real time: seen to move, and stopped from its own page, where the token is known still.
async function recorded(page, checks, visit) {
  await start(page, { name: "desk", duration: "1h", at: "" });
  await heading(page, "Recording desk.");
  await moves(page, checks);
  await page.locator("#state a[href^='/captures/']").click();
  await page.waitForURL(/\/captures\/\d+$/);
  await settled(page);
  await checks.page(page, "capture-running");
  await stop(page, visit, "Stop this capture?");
  await page.getByRole("button", { name: "keep from deletion" }).waitFor();
  const [desk] = await captures(page);
  checks.that("token", desk.name === "desk" && desk.state !== "capturing", `${desk.name} is ${desk.state}`);
}

/// Where the daemon has gone the page says so, since what it shows is old, and does not report a change as done.
async function lost(page, checks, visit, pid) {
  await page.goto(new URL("/", page.url()).href);
  await page.locator("#minute svg path").first().waitFor({ state: "attached" });
  visit.cut = true;
  process.kill(pid, "SIGTERM");
  await page.locator("#lost").filter({ hasText: "The daemon is not heard since" }).waitFor();
  await start(page, { name: "unheard", duration: "1h" });
  await said(page, "not reached");
  await checks.looks(page, "first-lost");
  checks.count("lost");
}
