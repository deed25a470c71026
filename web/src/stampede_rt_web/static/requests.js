// One request of each kind runs at a time. A slow page asks less often, so its requests do not pile up.

const TIMEOUT_MILLIS = 15_000;

export async function ask(path, parameters = {}) {
  const query = new URLSearchParams();
  for (const [key, value] of Object.entries(parameters)) {
    for (const one of Array.isArray(value) ? value : [value]) query.append(key, one);
  }
  let response;
  try {
    response = await fetch(`api/${path}?${query}`, { signal: AbortSignal.timeout(TIMEOUT_MILLIS) });
  } catch {
    throw new Error("The page's server does not answer. Is `stampede web` still running?");
  }
  if (response.status === 401) location.assign("login");
  const isJson = response.headers.get("content-type")?.startsWith("application/json");
  const answer = isJson ? await response.json() : { failure: await response.text() };
  if (!response.ok) throw new Error(answer.failure || `status ${response.status}`);
  return answer;
}

// Calls `work` again and again, `pause` milliseconds after the end of the previous call. A hidden tab makes no calls. After each
// call, calls `reportFailure` with the error, or with null.
export function repeat(pause, work, reportFailure) {
  let woken = () => {};
  const loop = async () => {
    for (;;) {
      if (!document.hidden) {
        try {
          await work();
          reportFailure(null);
        } catch (error) {
          reportFailure(error);
        }
      }
      await new Promise((resolve) => {
        woken = resolve;
        setTimeout(resolve, pause);
      });
    }
  };
  loop();
  return () => woken();
}
