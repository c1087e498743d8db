// Two captures side by side, and diagnoses against another capture and with a reference, all from the pages.

import { literal, said, settled } from "./live.mjs";

/// A recording of white noise, 100 s at 40 Hz, the same for the same seed.
function recording(seed) {
  let state = seed;
  const uniform = () => (state = (1_103_515_245 * state + 12_345) % 2_147_483_648) / 2_147_483_648;
  const noise = () => Array.from({ length: 12 }, uniform).reduce((sum, one) => sum + one, -6);
  const rows = Array.from({ length: 4000 }, (_, row) => `${(row * 0.025).toFixed(3)},${(1e-3 * noise()).toFixed(9)}`);
  return `time_s,gyro_x_rad_s\n${rows.join("\n")}\n`;
}

async function imported(page, address, name, seed) {
  const answer = await page.request.post(`${address}/v1/imports?name=${name}`, {
    headers: { "Content-Type": "text/csv" },
    data: recording(seed),
  });
  return `${address}/captures/${(await answer.json()).capture}`;
}

/// From a capture's page to it and the demonstration's side by side; without scripts as well.
export async function compared(page, checks, plain, capture, name, patience) {
  await page.goto(capture);
  await settled(page, patience);
  await page.getByLabel("side by side with").selectOption({ label: "demo" });
  await page.getByRole("button", { name: "show both" }).click();
  await page.waitForURL(/\/compare\?a=\d+&b=\d+$/);
  await page.waitForFunction(() => !document.querySelector("main[data-waits]"), undefined, patience);
  await page.getByRole("heading", { level: 2, name: "Noise parameters" }).waitFor();
  const rows = await page.getByRole("group", { name: "noise parameters" }).getByRole("row").count();
  checks.that("compared", rows >= 28, `${rows} rows of noise parameters of two captures`);
  const both = page.locator("img[src*='?beside=']");
  checks.same("compared", await both.count(), 9, "pictures with a curve of each capture");
  const png = page.getByRole("link", { name: "PNG" });
  checks.same("compared", await png.count(), await page.locator("main img").count(), "links to PNG beside pictures");
  const answer = await page.request.get(new URL(await png.first().getAttribute("href"), page.url()).href);
  checks.same("compared", answer.headers()["content-type"], "image/png", "the link beside a picture");
  await literal(page, checks, name, "two captures side by side");
  await checks.page(page, "compare");
  await checks.plain(plain, page.url(), "compare-without-scripts");
  await page.getByRole("link", { name: "two captures", exact: true }).click();
  await page.waitForURL(/\/compare$/);
  await checks.page(page, "compare-choice");
}

/// Against another capture, which takes the place of a model; then with the file of an encoder, whose axis it does not name.
export async function against(page, checks, visit, address, patience) {
  await imported(page, address, "desk", 1);
  const capture = await imported(page, address, "foam", 2);
  await page.goto(capture);
  await settled(page, patience);
  await page.getByLabel("compare with").selectOption({ label: "desk" });
  await page.getByRole("button", { name: "diagnose" }).click();
  await page.waitForURL(/\/diagnoses\/\d+$/);
  await page.getByRole("heading", { name: /^The gap, in/ }).waitFor(patience);
  checks.that("compared", (await page.locator("main").innerText()).includes("desk"), "the diagnosis does not name the other capture");
  visit.expected.add(`400 /v1/captures/${capture.split("/").pop()}/diagnoses`);
  await page.goto(capture);
  await settled(page, patience);
  const turns = Array.from({ length: 1000 }, (_, row) => `${(row * 0.1).toFixed(1)},${(20 * Math.sin(row / 30)).toFixed(4)}`);
  const file = { name: "motor.csv", mimeType: "text/csv", buffer: Buffer.from(`time_s,encoder_rpm\n${turns.join("\n")}\n`) };
  await page.getByLabel("or a reference's file").setInputFiles(file);
  await page.getByRole("button", { name: "diagnose" }).click();
  await said(page, "reference_axis");
  await page.getByLabel("an encoder's axis").selectOption("x");
  await page.getByRole("button", { name: "diagnose" }).click();
  await page.waitForURL(/\/diagnoses\/\d+$/);
  const id = page.url().split("/").pop();
  const job = await (await page.request.get(`${address}/v1/jobs/${id}`)).json();
  checks.same("compared", job.params.reference?.axis, "x", "the axis of the reference");
}
