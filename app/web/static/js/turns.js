// Answers that come too late: those to a question that was asked anew since.

/** Return a function that begins a turn; it returns a function that says whether no later turn has begun. */
export function turns() {
  let last = 0;
  return () => {
    const mine = (last += 1);
    return () => mine === last;
  };
}
