// Focus stays where it was when the part of the page around it is drawn anew.
(() => {
  const name = (e) => e.tagName + "|" + (e.getAttribute("aria-label") || e.textContent.trim());
  let last = null, place = 0;
  const like = (wanted) => [...document.querySelectorAll(wanted.split("|")[0])].filter((e) => name(e) === wanted);
  document.addEventListener("focusin", (event) => {
    last = name(event.target);
    place = like(last).indexOf(event.target);
  });
  document.addEventListener("focusout", (event) => {
    const left = event.target;
    setTimeout(() => {
      if (left.isConnected && document.activeElement === document.body) last = null;
    });
  });
  new MutationObserver(() => {
    if (!last || document.activeElement !== document.body) return;
    const found = like(last);
    (found[place] || found[0])?.focus({ preventScroll: true });
  }).observe(document.documentElement, { childList: true, subtree: true });
})();
// Tab leaves the editor, as it leaves every field; spaces indent.
document.addEventListener("keydown", (event) => {
  if (event.key === "Tab" && event.target.closest?.(".cm-editor")) event.stopImmediatePropagation();
}, true);
// Pages in frames follow the look that is chosen here.
function studioTheme(dark) {
  document.documentElement.style.colorScheme = dark === null ? "light dark" : dark ? "dark" : "light";
  const theme = dark === null ? "" : dark ? "dark" : "light";
  for (const frame of document.querySelectorAll("iframe")) frame.contentWindow.postMessage({ theme }, "*");
}
