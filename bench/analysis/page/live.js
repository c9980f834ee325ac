// A run that goes on: what it is told comes over a WebSocket beside the page.
//
// Messages are JSON: {"append": {"pool": {name: [values]}, "events": [event]}}, values that columns grow by and
// events as the data object has them; {"status": text}; {"replace": data}, everything, when the run has ended.

function showAppended(more) {
  const before = lastTime();
  grow(more);
  drawPlots("all");
  if (more.events?.length) fillEvents();
  showTimeLine();
  if (!cursor.follows) return;
  if (!player.playing) player.start();
  if (before === firstTime()) setTime(lastTime());
}

function showReplaced(whole) {
  data = whole;
  player.pause();
  cursor.follows = false;
  showAll();
  setTime(cursor.time);
}

function watchFeed() {
  const address = new URL("feed", location.href);
  address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
  const socket = new WebSocket(address);
  const status = byId("status");
  status.hidden = false;
  status.textContent = "connecting ...";
  let ended = false;
  socket.addEventListener("open", () => {
    status.textContent = "live";
  });
  socket.addEventListener("message", (event) => {
    const told = JSON.parse(event.data);
    if (told.status) status.textContent = told.status;
    if (told.append) showAppended(told.append);
    if (told.replace) {
      ended = true;
      status.textContent = "the run has ended";
      showReplaced(told.replace);
    }
  });
  socket.addEventListener("close", () => {
    if (!ended) status.textContent = "the connection has ended; what came until then stays";
    player.pause();
  });
}

if (data.live) addEventListener("load", watchFeed);
