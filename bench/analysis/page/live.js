// A live run: its data arrives over a WebSocket from the server of the page.
//
// Messages are JSON: {"append": {"pool": {name: [values]}, "events": [event]}} with values to append to columns and
// events as in the data object; {"status": text}; {"replace": data} with the complete data when the run has ended.

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
    if (!ended) status.textContent = "connection closed; showing what arrived before";
    player.pause();
  });
}

if (data.live) addEventListener("load", watchFeed);
