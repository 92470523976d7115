// Makes a number that is typed a command on Enter, or when its field is left; Escape drops it.
// viser would send every key. With `slidersWait`, likewise a slider when it is released.
function watchInputs(slidersWait) {
  'use strict';
  if (window.inputsWatched) return;  // a page that has lost its connection runs this again
  window.inputsWatched = true;

  // A browser tells of a `change` on Enter and on leaving. What React has shown last is the
  // field's `defaultValue`.
  const isNumber = element => element.matches?.('.mantine-NumberInput-input');
  const isComplete = text => text.trim() !== '' && Number.isFinite(Number(text));
  const putBack = field => { field.value = field.defaultValue; };
  const {set: setUnseen} = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value');
  let passing = false;
  // As if all of it were pasted over the number that was there, which React is told to expect.
  const paste = (field, text) => {
    field.setSelectionRange(0, field.value.length);
    field.dispatchEvent(new KeyboardEvent('keydown', {bubbles: true}));
    setUnseen.call(field, text);
    field.setSelectionRange(text.length, text.length);
    passing = true;
    field.dispatchEvent(new Event('input', {bubbles: true}));
    passing = false;
  };
  const watch = (name, work) => window.addEventListener(name, event => {
    if (isNumber(event.target) && work(event)) event.stopImmediatePropagation();
  }, true);
  watch('input', () => !passing);
  watch('change', ({target: field}) => {
    const text = field.value;
    putBack(field);
    if (isComplete(text)) paste(field, text);
    return true;
  });
  // A field that is left would replace what is out of bounds by the bound, a command of its own.
  watch('focusout', () => true);
  watch('keydown', ({key, target: field}) => {
    if (key === 'Escape') putBack(field);
    return key === 'ArrowUp' || key === 'ArrowDown';  // a step would be sent at once
  });
  if (!slidersWait) return;

  // viser sends a slider's value at every move, with the frame that shows it and `LATE` after that.
  const LATE = 100;  // ms, at most
  const SLIDER = '.mantine-Slider-root, .multi-slider';
  const post = Worker.prototype.postMessage;  // which viser sends by
  const held = new Map();  // what sends the last value of each element
  let drags = 0;
  let dragged = false;
  Worker.prototype.postMessage = function (data, ...options) {
    const send = () => post.call(this, data, ...options);
    if (dragged && data?.message?.type === 'GuiUpdateMessage') held.set(data.message.uuid, send);
    else send();
  };
  const release = drag => {
    if (drag !== drags) return;  // it has been taken again
    dragged = false;
    held.forEach(send => send());
    held.clear();
  };
  const releaseLater = () => {
    const drag = drags;
    if (dragged) requestAnimationFrame(() => setTimeout(release, LATE, drag));
  };
  window.addEventListener('pointerdown', ({target}) => {
    if (!target.closest?.(SLIDER)) return;
    dragged = true;
    drags += 1;
  }, true);
  window.addEventListener('pointerup', releaseLater, true);
  window.addEventListener('pointercancel', releaseLater, true);
}
