/* Shows the messages of the server. */
const shown = document.getElementById("state");
const vehicle = location.pathname.startsWith("/v/") ? location.pathname.slice(3) : null;
const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/socket`);
socket.addEventListener("open", () => socket.send(JSON.stringify({ type: "follow", vehicle })));
socket.addEventListener("message", (event) => {
  const message = JSON.parse(event.data);
  if (message.type !== "beat") shown.textContent = `${JSON.stringify(message)}\n${shown.textContent}`.slice(0, 20000);
});
