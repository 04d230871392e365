/* Says why the last login failed; the page works without it. */
const REASONS = { wrong: "Name or password are wrong.", wait: "Too many attempts. Wait a minute, then try again." };
const failed = new URLSearchParams(location.search).get("failed"), note = document.getElementById("failed");
if (failed !== null) {
  note.textContent = REASONS[failed] || "The login failed.";
  note.hidden = false;
}
document.documentElement.dataset.ready = "yes";
