// The theme: the system's, until the button chooses another. It runs before the page is drawn; what draws by itself hears "themechange".

(() => {
  const KEY = "vemlight theme", root = document.documentElement;
  const CHOICES = { system: ["◐", "as the system"], light: ["☀", "light"], dark: ["☾", "dark"] };
  const system = matchMedia("(prefers-color-scheme: light)");
  let choice = "system";
  try {
    choice = localStorage.getItem(KEY) ?? "system";
  } catch { /* browsers may be set to store nothing: then it is the system's until somebody chooses */ }
  if (!(choice in CHOICES)) choice = "system";

  function apply() {
    root.dataset.theme = choice === "system" ? (system.matches ? "light" : "dark") : choice;
    const button = document.getElementById("theme"), [sign, words] = CHOICES[choice];
    if (button) {
      button.textContent = sign;
      button.setAttribute("aria-label", `Theme: ${words}`);
      button.title = `Theme: ${words}`;
    }
    document.dispatchEvent(new Event("themechange"));
  }

  system.addEventListener("change", apply);
  document.addEventListener("DOMContentLoaded", () => {
    apply();
    document.getElementById("theme").addEventListener("click", () => {
      const names = Object.keys(CHOICES);
      choice = names[(names.indexOf(choice) + 1) % names.length];
      try {
        localStorage.setItem(KEY, choice);
      } catch { /* as above */ }
      apply();
    });
  });
  apply();
})();
