#!/usr/bin/env node
// The pages as people use them: a headless Chromium goes through the demonstration from its first page to its diagnosis, and
// through a daemon that wants a token.
//
//     node tests/browser/pages.mjs --install
//     node tests/browser/pages.mjs --demo http://127.0.0.1:8100 --guarded http://127.0.0.1:8101 --token TOKEN --pid N --pictures DIR
//
// --demo: `vn100d demo`, begun a moment ago; --guarded: a daemon with that token and a sensor that sends, nothing recorded,
// and --pid its process, which is ended last to see what the page says then. One of the two may be left out. DIR gets a picture of each page at 400 and 1280 px, on light and on dark. The last line
// tells what held, how often; exit code 1 with everything that did not.

import { parseArgs } from "node:util";
import { install, launch } from "./browser.mjs";
import { Checks } from "./checks.mjs";
import { demonstration } from "./demonstration.mjs";
import { guarded } from "./guarded.mjs";

const { values } = parseArgs({
  options: {
    install: { type: "boolean" },
    demo: { type: "string" },
    guarded: { type: "string" },
    token: { type: "string" },
    pid: { type: "string" },
    pictures: { type: "string", default: "target/screenshots" },
  },
});

async function run() {
  const browser = await launch();
  const checks = new Checks(values.pictures);
  // At once: the demonstration's capture does not wait for the other daemon's.
  const stories = [];
  if (values.demo) stories.push(demonstration(browser, checks, values.demo));
  if (values.guarded) stories.push(guarded(browser, checks, values.guarded, values.token, Number(values.pid)));
  for (const { reason } of await Promise.allSettled(stories)) {
    // What a person waits for and does not come ends a story; what was seen until then is told too.
    if (reason) checks.that("story", false, reason.stack);
  }
  await browser.close();
  const wrong = checks.wrong();
  for (const told of wrong) console.error(`- ${told}`);
  console.log(JSON.stringify({ held: checks.held, faults: wrong.length }));
  process.exitCode = wrong.length === 0 && stories.length > 0 ? 0 : 1;
}

if (values.install) install();
else await run();
