// The demonstration: the first page moves, the capture ends, its page has the numbers and pictures, and the diagnosis names
// what the model lacks. Then a capture of a hostile name, begun, stopped and diagnosed from the pages.

import { Visit } from "./browser.mjs";
import { against, compared } from "./compared.mjs";
import { heading, keepsFocus, literal, moves, reloads, said, samples, settled, start, stop } from "./live.mjs";

/// Five hours in under a minute, on a machine that does other things as well.
const PATIENCE = { timeout: 240_000 };
/// Markup as far as a capture may be named: a name has no `/`.
const HOSTILE = "<script>alert(1)<img src=x onerror=alert(2)>\"'&amp;<b>bold";

export async function demonstration(browser, checks, address) {
  const visit = await Visit.begin(browser, checks);
  const plain = await Visit.begin(browser, checks, { javaScriptEnabled: false });
  const page = await visit.page();
  await page.goto(address);
  await heading(page, "Recording demo.");
  // At once: the capture is over soon.
  await Promise.all([reloads(plain, checks, address), moves(page, checks).then(() => keepsFocus(page, checks))]);
  await checks.plain(plain.context, address, "first-without-scripts");
  await checks.page(page, "first-recording");
  await heading(page, "The sensor sends, nothing is recorded.", PATIENCE);
  checks.that("moves", await page.evaluate(() => globalThis.sameVisit === true), "the end of the capture loaded the first page anew");

  const capture = await report(page, checks);
  await checks.page(page, "capture");
  await checks.plain(plain.context, page.url(), "capture-without-scripts");
  await closer(page, checks, capture);
  await diagnosed(page, checks, address);
  await checks.page(page, "diagnosis");
  await checks.page(await goTo(page, address), "first-idle");
  await listed(page, checks, plain.context);
  const other = await hostile(page, checks, visit, address);
  await compared(page, checks, plain.context, other, HOSTILE, PATIENCE);
  await against(page, checks, visit, address, PATIENCE);
  await visit.end();
  await plain.end();
}

async function goTo(page, address) {
  await page.goto(address);
  return page;
}

/// From the first page to the capture's, which waits for its numbers by itself.
async function report(page, checks) {
  await page.locator("#captures").getByRole("link", { name: "demo", exact: true }).click();
  await page.waitForURL(/\/captures\/\d+$/);
  await heading(page, "demo");
  await settled(page, PATIENCE);
  await page.getByRole("heading", { level: 2, name: "Noise parameters" }).waitFor();
  await page.getByText("720000 samples, none missing").waitFor();
  // What came while it waited has not taken the place of what may be asked for.
  await page.getByRole("button", { name: "keep from deletion" }).waitFor();
  await page.getByRole("button", { name: "diagnose" }).waitFor();
  await page.locator("img[src$='plots/allan-gyro.svg']").waitFor();
  const pictures = await page.locator("main img").count();
  checks.that("report", pictures >= 10, `${pictures} pictures on the capture's page`);
  return new URL(page.url()).pathname;
}

/// Into a channel: a drag across its picture shows the part that was dragged over.
async function closer(page, checks, capture) {
  const details = page.locator("details", { hasText: "look closer at accel_z" });
  if (!(await details.evaluate((one) => one.open))) await details.locator("summary").click();
  await page.getByRole("link", { name: "look closer at accel_z" }).click();
  await page.waitForURL(`**${capture}/series/accel_z`);
  await checks.page(page, "series");
  const image = page.locator("img.zoom");
  const length = Number(await image.getAttribute("data-to"));
  const box = await image.boundingBox();
  // The plot's own field lies between these shares of the picture's width.
  const [left, right] = [84 / 560, 546 / 560];
  const at = (share) => [box.x + box.width * (left + share * (right - left)), box.y + box.height / 2];
  await page.mouse.move(...at(0.25));
  await page.mouse.down();
  await page.mouse.move(...at(0.4), { steps: 5 });
  await page.mouse.up();
  await page.waitForURL(/from=.*&to=/);
  const { searchParams } = new URL(page.url());
  for (const [key, share] of [["from", 0.25], ["to", 0.4]]) {
    const found = Number(searchParams.get(key)) / length;
    checks.that("zoom", Math.abs(found - share) < 0.005, `${key} is ${found} of the whole instead of ${share}`);
  }
  await page.getByRole("link", { name: "later" }).click();
  await page.waitForURL((url) => Number(url.searchParams.get("from")) > 0.3 * length);
  await checks.page(page, "series-closer");
}

/// The first page leads to the demonstration's own diagnosis, of the hum that its model lacks.
async function diagnosed(page, checks, address) {
  await page.goto(address);
  const link = page.locator("#diagnoses a").first();
  await link.filter({ hasText: "accel_z: a 11.4" }).waitFor(PATIENCE);
  await link.click();
  await page.waitForURL(/\/diagnoses\/\d+$/);
  const sentence = await page.locator("h1").innerText();
  checks.that("diagnosis", /^accel_z: a 11\.4\d* Hz tone .* that the model lacks/.test(sentence), `it says ${sentence}`);
  await page.getByRole("heading", { name: "What the model lacks" }).waitFor();
}

/// From the first page to the list of captures, where a search finds the capture, also without scripts.
async function listed(page, checks, plain) {
  await page.getByRole("navigation", { name: "lists" }).getByRole("link", { name: "captures" }).click();
  await heading(page, "Captures");
  await page.getByRole("searchbox").fill("DEMO");
  await page.getByRole("button", { name: "search" }).click();
  await page.waitForURL(/\/captures\?q=DEMO$/);
  const row = page.getByRole("row").filter({ has: page.getByRole("link", { name: "demo", exact: true }) });
  checks.same("list", await row.count(), 1, "rows of the capture that was searched");
  await checks.page(page, "captures");
  await checks.plain(plain, page.url(), "captures-without-scripts");
  for (const list of ["diagnoses", "jobs", "models"]) {
    await page.getByRole("navigation", { name: "lists" }).getByRole("link", { name: list }).click();
    await page.waitForURL(new RegExp(`/${list}$`));
    checks.that("list", (await page.getByRole("row").count()) > 1, `the list of ${list} has no row`);
    await checks.page(page, list);
  }
}

/// Diagnosed again, with a model that is a file.
async function withFile(page, capture) {
  const model = { format: "vn100d-sensor-model-1", name: "unit", rate_hz: 40, channels: { gyro_x: { N: 1e-4 } } };
  const choose = async (name, text) => {
    const file = { name, mimeType: "application/json", buffer: Buffer.from(text) };
    await page.getByLabel("or with a model's file").setInputFiles(file);
    await page.getByRole("button", { name: "diagnose" }).click();
  };
  await page.goto(capture);
  await settled(page, PATIENCE);
  await choose("night.csv", "time_s,gyro_x");
  await said(page, "is no JSON");
  await choose("unit.json", JSON.stringify(model));
  await page.waitForURL(/\/diagnoses\/\d+$/);
  await page.getByRole("heading", { name: /^The gap, in/ }).waitFor(PATIENCE);
}

/// Named as no one should, begun, looked at, stopped, kept and diagnosed without leaving the pages.
async function hostile(page, checks, visit, address) {
  visit.expected.add("400 /v1/captures").add("422 /v1/captures");
  await goTo(page, address);
  await start(page, { name: "a/b" });
  await said(page, "name");
  await start(page, { name: "later", duration: "soon" });
  await said(page, "duration");
  checks.that("refused", await page.locator(".said.alarm").isVisible(), "a refusal is not told as one");
  await start(page, { name: HOSTILE, duration: "100h" });
  await heading(page, `Recording ${HOSTILE}.`);
  await said(page, "Done.");
  checks.that("refused", !(await page.locator(".said.alarm").isVisible()), "what was done is told as a refusal");
  await moves(page, checks);
  while ((await samples(page)) < 60_000) await page.waitForTimeout(100);
  await literal(page, checks, HOSTILE, "the first page");
  await page.locator("#state a[href^='/captures/']").click();
  await page.waitForURL(/\/captures\/\d+$/);
  const capture = page.url();
  await literal(page, checks, HOSTILE, "the page of a capture that runs");
  // The capture stops soon, because each second of it is ten minutes of samples that are diagnosed afterwards.
  await stop(page, visit, "Stop this capture?");
  await page.getByRole("button", { name: "diagnose" }).waitFor(PATIENCE);
  await settled(page, PATIENCE);
  await page.goto(`${capture}/series/gyro_x`);
  await literal(page, checks, HOSTILE, "the page of a channel");
  await page.goto(capture);
  await page.getByRole("button", { name: "keep from deletion" }).click();
  await page.getByText("kept from deletion").waitFor();
  const models = page.getByLabel("compare with");
  await models.locator("option").first().waitFor({ state: "attached" });
  await page.getByRole("button", { name: "diagnose" }).click();
  await page.waitForURL(/\/diagnoses\/\d+$/);
  await page.getByRole("heading", { name: /^The gap, in/ }).waitFor(PATIENCE);
  await literal(page, checks, HOSTILE, "the page of a diagnosis");
  await withFile(page, capture);
  await page.goto(address);
  await literal(page, checks, HOSTILE, "the first page afterwards");
  await checks.page(page, "first-hostile");
  return capture;
}
