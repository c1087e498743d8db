// The first page: that it moves, and what is asked for on it.

const SAMPLES = "#state a[href^='/captures/']";

/// The samples of the running capture, as the page has them.
export async function samples(page) {
  return Number.parseInt(await page.locator(SAMPLES).innerText(), 10);
}

/// Waits until the page says this first of all.
export async function heading(page, text, options) {
  await page.getByRole("heading", { level: 1, name: text, exact: true }).waitFor(options);
}

/// Waits until nothing is being computed any more that the page will show: until then it asks again every few seconds, by its
/// script or by itself.
export async function settled(page, options) {
  const still = () =>
    document.querySelector("footer") !== null && document.querySelector("meta[http-equiv=refresh], main[data-waits]") === null;
  await page.waitForFunction(still, undefined, options);
  await page.waitForLoadState();
}

/// Waits until samples, progress and the last minute are others than they were, on the same page.
export async function moves(page, checks) {
  await page.locator("#minute svg path").first().waitFor({ state: "attached" });
  // A navigation would lose it.
  await page.evaluate(() => (globalThis.sameVisit = true));
  const before = await seen(page);
  await page.waitForFunction(
    ([selector, was]) => {
      const path = document.querySelector("#minute svg path")?.getAttribute("d");
      const link = document.querySelector(selector);
      return link && path && Number.parseInt(link.innerText, 10) > was.samples && path !== was.path;
    },
    [SAMPLES, before],
    { timeout: 20_000 },
  );
  const after = await seen(page);
  checks.that("moves", after.progress >= before.progress, `progress went from ${before.progress} to ${after.progress}`);
  checks.that("moves", await page.evaluate(() => globalThis.sameVisit === true), "the first page was loaded anew");
}

async function seen(page) {
  return page.evaluate((selector) => ({
    samples: Number.parseInt(document.querySelector(selector).innerText, 10),
    path: document.querySelector("#minute svg path").getAttribute("d"),
    progress: document.querySelector("#state progress").value,
  }), SAMPLES);
}

/// Those who go through the page by keys stay where they are while it changes.
export async function keepsFocus(page, checks) {
  const row = page.locator("#captures tr", { has: page.locator("a") }).first();
  const link = row.locator("a").first();
  await link.focus();
  const before = await row.innerText();
  await page.waitForFunction((was) => document.querySelector("#captures tr:has(a)").innerText !== was, before);
  const kept = await page.evaluate(() => document.activeElement.closest("#captures tr") !== null);
  checks.that("moves", kept, "a link of the first page lost the focus while the page changed");
}

/// Without scripts the page reloads by itself, and has news then.
export async function reloads(visit, checks, address) {
  const page = await visit.page();
  await page.goto(address);
  checks.that("static", (await page.locator("section.controls:visible").count()) === 0, "forms are shown that need scripts");
  checks.that("static", await page.locator("noscript code", { hasText: "curl" }).isVisible(), "nothing says how to start without scripts");
  const before = await samples(page);
  await page.waitForEvent("load", { timeout: 15_000 });
  const after = await samples(page);
  checks.that("static", after > before, `without scripts: ${before} samples, then ${after}`);
  await page.close();
}

/// Fills the form of the first page in and sends it.
export async function start(page, { name, duration, at }) {
  if (name !== undefined) await page.getByLabel("name").fill(name);
  if (duration !== undefined) await page.getByLabel("duration").fill(duration);
  if (at !== undefined) await page.getByLabel("begin at").fill(at);
  await page.getByRole("button", { name: "start", exact: true }).click();
}

/// Returns what the page answers to a change.
export async function said(page, text) {
  await page.locator(".said").filter({ hasText: text }).waitFor();
}

/// Stops what runs, with the question that a page asks first.
export async function stop(page, visit, question) {
  visit.confirm = question;
  await page.getByRole("button", { name: "stop", exact: true }).click();
}

/// A name that is markup stands on the page as it was written, and is nothing else.
export async function literal(page, checks, name, where) {
  const text = await page.locator("body").innerText();
  checks.that("escaped", text.includes(name), `${where}: ${name} is not to be read`);
  const made = await page.locator("img[src='x'], main script, main b:has-text('bold')").count();
  checks.same("escaped", made, 0, `${where}: elements that a name made`);
}
