// Before anything is drawn: the theme that was chosen last, or that of the system; ?theme=light or ?theme=dark decides.
(() => {
  const asked = new URLSearchParams(location.search).get("theme");
  let kept = null;
  try { kept = localStorage.getItem("covey-theme"); } catch { /* no storage: the system decides */ }
  const system = matchMedia("(prefers-color-scheme: light)").matches ? "light" : "dark";
  document.documentElement.dataset.theme = asked || kept || system;
})();
