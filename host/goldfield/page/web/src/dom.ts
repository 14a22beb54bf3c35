// Small helpers around the document. Styles are set by property, never as text: the page's policy forbids the latter.

import type { Said } from "./words";

export function byId<T extends HTMLElement = HTMLElement>(id: string): T {
  const element = document.getElementById(id);
  if (!element) throw new Error(`the page has no ${id}`);
  return element as T;
}

/** Set a text only where it changes, so that nothing is laid out, or read out, again for nothing. */
export function setText(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** Show a chip: its tone, its mark and its word. */
export function setChip(name: string, said: Said): void {
  byId(name).dataset.tone = said.tone;
  setText(byId(`${name}-mark`), said.mark);
  setText(byId(`${name}-word`), said.word);
}

/** Return a colour of the style sheet, which differs in the dark. */
export function colour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}
