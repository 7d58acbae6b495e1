"""Sweeps over bonds that threads share: each takes parts of the work until none is left, and
helpers stay in a kernel between sweeps."""

import warp as wp


def unpacked(struct, of="of"):
    """C++ that names what a kernel's struct holds."""
    return "".join(f"auto& {name} = {of}.{name};" for name in struct.vars)


LINE = 16
"""Numbers of a line of cache."""
BOX = """
#if defined(__linux__)
    int rest(void) asm("sched_yield");
    int doze(void*) asm("sem_wait");
    int wake(void*) asm("sem_post");
    const bool sleeps = true;
#else
    const bool sleeps = false;
    const auto rest = [] {};
    const auto doze = [](void*) {};
    const auto wake = [](void*) {};
#endif
"""
STAY = (
    BOX
    + """
    long long* box = of.data;
NAMES
    const long long rung = __atomic_load_n(bell, __ATOMIC_SEQ_CST);
    long long served = 0, open;
    for (int n = 0; rung == __atomic_load_n(bell, __ATOMIC_SEQ_CST); ++n) {
        if (n > 1000 && !sleeps)
            break;
        if (n > 1000) {
            __atomic_fetch_add(asleep, 1, __ATOMIC_SEQ_CST);
            open = __atomic_load_n(box, __ATOMIC_SEQ_CST);
            if ((open == 0 || open == served) && rung == __atomic_load_n(bell, __ATOMIC_SEQ_CST))
                doze(bed);
            __atomic_fetch_sub(asleep, 1, __ATOMIC_SEQ_CST);
            n = 0;
        } else if (n > 100)
            rest();
        if ((open = __atomic_load_n(box, __ATOMIC_RELAXED)) == 0 || open == served)
            continue;
        __atomic_fetch_add(inside, 1, __ATOMIC_SEQ_CST);  // nothing closes from here on
        if ((open = __atomic_load_n(box, __ATOMIC_SEQ_CST))) {
            ((void (*)(void*))call[0])((void*)call[1]);
            served = open;
            n = 0;
        }
        __atomic_fetch_sub(inside, 1, __ATOMIC_SEQ_CST);
    }
"""
)
"""What a helper does that stays: it looks into a box for some 0.3 ms, then sleeps until a leader
wakes it, and leaves when the bell rings. The box, its numbers on lines of their own: number of the
open sweep or 0; helpers inside; function and data of the sweep; whether somebody leads, and number
of the last sweep; helpers asleep; bell; semaphore."""
NAMES = """
    long long *inside = box + 8, *call = box + 16, *lead = box + 24, *asleep = box + 32;
    long long *bell = box + 40, *bed = box + 48;
"""


@wp.func_native(STAY.replace("NAMES", NAMES))
def _stay(of: wp.array(dtype=wp.int64)): ...


@wp.kernel(enable_backward=False, module="unique")
def stay(of: wp.array(dtype=wp.int64)):
    """A helper serves sweeps until the bell rings."""
    _stay(of)


def shared(samples="1", **phases):
    """C++ of work on pieces of samples s, in phases, which all threads that call it share.

    Each thread has a stretch of its own, where the phase before has left in its cache what it
    reads; then it takes parts of the others'. Who comes late finds nothing left, and nobody waits
    for it. `turns` counts who has come, and for each phase what is done and, of each thread's
    stretch, what has been taken; zeros at first, LINE apart, for no two threads to write to one
    line of cache.

    One thread leads: it leaves the work in a box, by address, for helpers that `stay` in a kernel
    between sweeps: to wake one through Python takes a third of a small sweep. turns[2:4] is the
    address of the box, see STAY.

    `phases`: what is done with a piece, by the name of the pieces.
    """
    text = """
    const int threads = turns.data[1];
    long long* box = *(long long**)(turns.data + 2);
NAMES    auto all = [&](int me) {
        if (me < 0)
            me = 1 + __atomic_fetch_add(turns.data, 1, __ATOMIC_RELAXED);
        int* done = turns.data + LINE;
        const auto share = [&](const auto& pieces, auto work) {
            const int parts = 32;
            const long long each = pieces.shape[0], count = each * SAMPLES, all = threads * parts;
            for (int other = 0; other < threads; ++other) {
                const int stretch = (me + other) % threads;
                int *taken = done + LINE * (1 + stretch), own = 0;
                for (int n; (n = __atomic_fetch_add(taken, 1, __ATOMIC_RELAXED)) < parts; ++own) {
                    const long long part = stretch * parts + n;
                    for (long long t = count * part / all; t < count * (part + 1) / all; ++t)
                        work(t / each, pieces.data[t % each]);
                }
                if (own)
                    __atomic_fetch_add(done, own, __ATOMIC_RELEASE);
            }
            for (int n = 0; __atomic_load_n(done, __ATOMIC_ACQUIRE) < all; ++n)
                if (n > 1000)
                    rest();
            done += LINE * (1 + threads);
        };
        PHASES
    };
    const auto joined = [](void* of) {
        auto& work = *(decltype(all)*)of;
        work(-1);
    };
    long long nobody = 0;
    if (threads == 1 || !__atomic_compare_exchange_n(
            lead, &nobody, 1, false, __ATOMIC_SEQ_CST, __ATOMIC_RELAXED)) {
        all(0);
        return;
    }
    call[0] = (long long)(void (*)(void*))joined;
    call[1] = (long long)&all;
    __atomic_store_n(box, ++lead[1], __ATOMIC_SEQ_CST);
    for (long long n = __atomic_load_n(asleep, __ATOMIC_SEQ_CST); n > 0; --n)
        wake(bed);
    all(0);
    __atomic_store_n(box, 0, __ATOMIC_SEQ_CST);
    for (int n = 0; __atomic_load_n(inside, __ATOMIC_SEQ_CST); ++n)
        if (n > 1000)
            rest();
    __atomic_store_n(lead, 0, __ATOMIC_RELEASE);
"""
    each = (f"share({of}, [&](int s, auto piece) {{{work}}});" for of, work in phases.items())
    text = BOX + text.replace("SAMPLES", samples).replace("PHASES", "\n".join(each))
    return text.replace("LINE", str(LINE)).replace("NAMES", NAMES)
