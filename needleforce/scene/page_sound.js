"use strict";
// The sound of an event. The card of the clinician's view carries the latest event and its time; a later one
// than that of the last look sounds. A browser lets a page sound once somebody has pressed or typed in it.
(() => {
  // Tones one after the other [Hz]; the more urgent the event, the more and the lower.
  const tones_Hz = {
    rupture: [880],
    hard_contact: [440, 440],
    too_near: [660, 440, 660, 440],
    past_target: [330, 330, 330, 330],
  };
  let context = null;
  let told_s = null;
  const sound = kind => tones_Hz[kind]?.forEach((frequency_Hz, number) => {
    const tone = new OscillatorNode(context, {frequency: frequency_Hz});
    const start_s = context.currentTime + 0.2 * number;
    tone.connect(new GainNode(context, {gain: 0.2})).connect(context.destination);
    tone.start(start_s);
    tone.stop(start_s + 0.15);
  });
  setInterval(() => {
    if (!context && navigator.userActivation?.hasBeenActive && window.AudioContext) {
      context = new AudioContext();
      document.documentElement.dataset.sound = "on";
    }
    const mark = document.querySelector("[data-event]");
    if (!mark) return;
    const time_s = Number(mark.dataset.time);
    if (context && told_s !== null && time_s > told_s) sound(mark.dataset.event);
    told_s = time_s;
  }, 50);
})();
