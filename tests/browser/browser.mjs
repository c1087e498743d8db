// The browser: where it and its driver are, and pages that are watched for what should not happen.

import { execFileSync } from "node:child_process";
import { copyFileSync, existsSync, mkdirSync, readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

const HERE = dirname(fileURLToPath(import.meta.url));
/// Nothing is written into the source tree: the packages lie beside what cargo builds.
const HOME = join(HERE, "..", "..", "target", "browser");

/// Brings the packages that package.json names, where they are not there in these versions.
export function install() {
  const wanted = Object.entries(JSON.parse(readFileSync(join(HERE, "package.json"), "utf8")).dependencies);
  const version = (name) => {
    const file = join(HOME, "node_modules", name, "package.json");
    return existsSync(file) ? JSON.parse(readFileSync(file, "utf8")).version : null;
  };
  if (wanted.every(([name, exact]) => version(name) === exact)) return;
  mkdirSync(HOME, { recursive: true });
  copyFileSync(join(HERE, "package.json"), join(HOME, "package.json"));
  const options = ["--no-package-lock", "--no-audit", "--no-fund", "--loglevel=error"];
  execFileSync("npm", ["install", "--prefix", HOME, ...options], { stdio: "inherit" });
}

function packages() {
  return createRequire(join(HOME, "package.json"));
}

/// The rules of accessibility, as text.
export function rules() {
  return readFileSync(packages().resolve("axe-core/axe.min.js"), "utf8");
}

function program() {
  const names = ["chromium", "chromium-browser", "google-chrome"];
  const found = execFileSync("sh", ["-c", `command -v ${names.join(" || command -v ")}`], { encoding: "utf8" });
  return found.trim();
}

/// A browser without a window.
export async function launch() {
  const { chromium } = packages()("playwright-core");
  // The superuser, whom CI is, gets no sandbox from it; /dev/shm is small in containers.
  const args = process.getuid() === 0 ? ["--no-sandbox"] : [];
  return chromium.launch({ executablePath: program(), args: [...args, "--disable-dev-shm-usage"] });
}

/// What a navigation may cut short: the stream of events, the live part, pictures that were still on their way, and a page
/// that was about to renew itself.
function interrupted(request) {
  const { pathname, search } = new URL(request.url());
  const asked = pathname === "/v1/events/stream" || search === "?part=live";
  const may = asked || request.resourceType() === "image" || request.isNavigationRequest();
  return may && request.failure().errorText === "net::ERR_ABORTED";
}

/// A person's visit: a browser context whose pages are watched.
export class Visit {
  constructor(context, checks) {
    this.context = context;
    this.checks = checks;
    /// Refusals that the story is about, as `401 /v1/captures`; any other answer of 400 and above is a fault.
    this.expected = new Set();
    /// While the line is cut on purpose, requests fail and that is said on the console.
    this.cut = false;
    /// What dialogs are answered: a confirmation where one is due; any other is a fault.
    this.confirm = null;
  }

  static async begin(browser, checks, options = {}) {
    const visit = new Visit(await browser.newContext({ reducedMotion: "reduce", ...options }), checks);
    visit.context.setDefaultTimeout(60_000);
    visit.context.on("page", (page) => visit.watch(page));
    return visit;
  }

  fault(page, kind, told) {
    this.checks.that(kind, false, `${page.url()}: ${told}`);
  }

  watch(page) {
    page.on("pageerror", (error) => this.fault(page, "script", `${error}`));
    page.on("console", (message) => {
      if (!["error", "warning"].includes(message.type()) || this.cut) return;
      // The console repeats every refused request.
      const refused = /the server responded with a status of (\d+)/.exec(message.text());
      const path = message.location().url ? new URL(message.location().url).pathname : "";
      if (refused && this.expected.has(`${refused[1]} ${path}`)) return;
      this.fault(page, "console", `${message.type()}: ${message.text()} (${message.location().url})`);
    });
    page.on("requestfailed", (request) => {
      if (!this.cut && !interrupted(request)) this.fault(page, "request", `${request.url()}: ${request.failure().errorText}`);
    });
    page.on("response", (response) => {
      const path = new URL(response.url()).pathname;
      if (response.status() < 400) this.checks.count("request");
      else if (!this.expected.has(`${response.status()} ${path}`)) this.fault(page, "request", `${path}: ${response.status()}`);
    });
    page.on("dialog", async (dialog) => {
      if (dialog.type() === "confirm" && dialog.message() === this.confirm) return dialog.accept();
      this.fault(page, "dialog", `${dialog.type()} ${dialog.message()}`);
      await dialog.dismiss();
    });
  }

  /// A page of its own, of a desk's width, on light.
  async page() {
    const page = await this.context.newPage();
    await page.setViewportSize({ width: 1280, height: 900 });
    await page.emulateMedia({ colorScheme: "light" });
    return page;
  }

  async end() {
    await this.context.close();
  }
}
