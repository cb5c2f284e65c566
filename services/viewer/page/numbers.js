// Numbers for people.

// With a narrow space between thousands.
export function grouped(value) {
  return value.toLocaleString("en").replaceAll(",", "\u202f");
}
