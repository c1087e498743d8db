// What holds of every page, whatever it shows; counted, so that a story that looks at nothing is no success.

import { mkdirSync } from "node:fs";
import { join } from "node:path";
import { rules } from "./browser.mjs";

const WIDTHS = [400, 1280];
const SCHEMES = ["light", "dark"];
/// How long a page's pictures may take: the daemon draws them when they are asked for.
const PICTURES_MS = 60_000;
const TAGS = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"];

function variants(name) {
  return WIDTHS.flatMap((width) => SCHEMES.map((colorScheme) => ({
    what: `${name} at ${width} px, ${colorScheme}`,
    width,
    colorScheme,
    file: `${name}-${width}-${colorScheme}.png`,
  })));
}

/// Counts what holds and keeps what does not, so that one run tells all of it.
export class Checks {
  constructor(folder) {
    this.folder = folder;
    this.held = {};
    this.faults = [];
    this.violations = new Map();
    this.axe = rules();
    mkdirSync(folder, { recursive: true });
  }

  /// Everything that does not hold.
  wrong() {
    const violations = [...this.violations].map(([told, places]) => `accessible: ${places.join("; ")}: ${told}`);
    return [...this.faults, ...violations];
  }

  count(kind) {
    this.held[kind] = (this.held[kind] ?? 0) + 1;
  }

  that(kind, holds, otherwise) {
    if (holds) this.count(kind);
    else if (!this.faults.includes(`${kind}: ${otherwise}`)) this.faults.push(`${kind}: ${otherwise}`);
  }

  same(kind, found, expected, what) {
    this.that(kind, found === expected, `${what}: found ${JSON.stringify(found)}, expected ${JSON.stringify(expected)}`);
  }

  /// All of it.
  async page(page, name) {
    await this.policy(page, name);
    await this.structure(page, name);
    await this.looks(page, name);
  }

  /// At the widths of a phone and a desk, on light and on dark, with a picture of each for a person.
  async looks(page, name) {
    for (const { what, width, colorScheme, file } of variants(name)) {
      await page.setViewportSize({ width, height: 900 });
      await page.emulateMedia({ colorScheme });
      await this.pictures(page, what);
      await this.accessible(page, what);
      await this.drawn(page, what, file);
    }
    await page.setViewportSize({ width: 1280, height: 900 });
    await page.emulateMedia({ colorScheme: "light" });
  }

  /// The same of an address without scripts, where pages cannot be asked for their accessibility. Each is loaded for itself: a
  /// page that renews itself shall not do so in the middle.
  async plain(context, address, name) {
    for (const { what, width, colorScheme, file } of variants(name)) {
      const page = await context.newPage();
      await page.setViewportSize({ width, height: 900 });
      await page.emulateMedia({ colorScheme });
      await page.goto(address);
      await this.structure(page, what);
      await this.pictures(page, what);
      await this.drawn(page, what, file);
      await page.close();
    }
  }

  async drawn(page, what, file) {
    const { wide, view } = await page.evaluate(() => ({
      wide: document.documentElement.scrollWidth,
      view: document.documentElement.clientWidth,
    }));
    this.that("width", wide <= view, `${what}: the page is ${wide} px wide in a window of ${view}`);
    await page.screenshot({ path: join(this.folder, file), fullPage: true });
    this.count("screenshot");
  }

  /// The answer forbids scripts in the page itself and anything from elsewhere.
  async policy(page, name) {
    const answer = await page.request.get(page.url());
    const policy = answer.headers()["content-security-policy"] ?? "";
    const directives = new Map(policy.split(";").map((one) => one.trim().split(/ +/)).map(([key, ...values]) => [key, values]));
    const scripts = directives.get("script-src") ?? [];
    this.same("policy", scripts.join(" "), "'self'", `${name}: script-src`);
    this.same("policy", directives.get("default-src")?.join(" "), "'none'", `${name}: default-src`);
  }

  async structure(page, name) {
    const found = await page.evaluate((own) => ({
      headings: document.querySelectorAll("h1").length,
      foreign: [...document.scripts].filter((script) => script.getAttribute("src") !== own).length,
      handlers: [...document.querySelectorAll("*")].filter((one) => one.getAttributeNames().some((key) => key.startsWith("on"))).length,
    }), "/assets/page.js");
    this.same("structure", found.headings, 1, `${name}: headings of the first order`);
    // Another role on it would hide it from those who go through a page by its headings.
    this.same("structure", await page.getByRole("heading", { level: 1 }).count(), 1, `${name}: headings of the first order by role`);
    this.same("structure", found.foreign, 0, `${name}: scripts besides the daemon's file`);
    this.same("structure", found.handlers, 0, `${name}: elements with a handler in the markup`);
  }

  /// Pictures load where they come into sight: what is closed is opened, and none waits for being scrolled to.
  async pictures(page, what) {
    const left = () => page.evaluate(() => {
      for (const details of document.querySelectorAll("details")) details.open = true;
      for (const image of document.images) image.loading = "eager";
      return [...document.images].filter((one) => !(one.complete && one.naturalWidth > 0)).map((one) => one.src);
    });
    const begun = Date.now();
    while ((await left()).length > 0 && Date.now() - begun < PICTURES_MS) await page.waitForTimeout(50);
    const missing = await left();
    this.that("pictures", missing.length === 0, `${what}: did not load: ${missing.join(" ")}`);
    this.held.picture = (this.held.picture ?? 0) + (await page.locator("img").count()) - missing.length;
  }

  async accessible(page, what) {
    // By the driver's own line: the page's policy lets in no script but the daemon's.
    if (!(await page.evaluate(() => "axe" in globalThis))) await page.evaluate(this.axe);
    const violations = await page.evaluate(async (tags) => {
      const result = await globalThis.axe.run(document, { runOnly: { type: "tag", values: tags }, resultTypes: ["violations"] });
      return result.violations.map(({ id, help, nodes }) => ({
        id,
        help,
        nodes: nodes.map(({ html, failureSummary }) => `${html.slice(0, 200)}\n      ${failureSummary.replaceAll("\n", "\n      ")}`),
      }));
    }, TAGS);
    for (const { id, help, nodes } of violations) {
      // The same on light and on dark is told once, with all places.
      const told = `${id}, ${help}, ${nodes.length} times, first\n      ${nodes[0]}`;
      this.violations.set(told, [...(this.violations.get(told) ?? []), what]);
    }
    if (violations.length === 0) this.count("accessible");
  }
}
