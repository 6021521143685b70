// Light or dark: as the system has it, until the reader chooses.

export class Theme {
  constructor(changed) {
    this.changed = changed;
    this.system = window.matchMedia("(prefers-color-scheme: dark)");
    this.chosen = null;
    this.system.addEventListener("change", () => this.apply());
  }

  get dark() {
    return this.chosen ?? this.system.matches;
  }

  toggle() {
    this.chosen = !this.dark;
    this.apply();
  }

  apply() {
    document.documentElement.dataset.theme = this.dark ? "dark" : "light";
    this.changed(this.dark);
  }
}
