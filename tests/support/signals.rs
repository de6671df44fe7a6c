//! What the tests start has the signals of a terminal, also where the tests themselves were
//! started in a shell's background, by `nohup` or by a build server.
//!
//! There, interrupts or hang-ups are ignored, and a program inherits what is ignored. A signal
//! with a handler is not inherited: what starts has its default. So each signal that is ignored
//! gets a handler that does nothing, before the first test.

const OF_A_TERMINAL: [libc::c_int; 3] = [libc::SIGHUP, libc::SIGINT, libc::SIGQUIT];

extern "C" fn nothing(_: libc::c_int) {}

extern "C" fn give_handlers() {
    for signal in OF_A_TERMINAL {
        // SAFETY: plain system calls before any thread starts; the handler does nothing.
        unsafe {
            let mut action: libc::sigaction = std::mem::zeroed();
            libc::sigaction(signal, std::ptr::null(), &mut action);
            if action.sa_sigaction == libc::SIG_IGN {
                action.sa_sigaction = nothing as extern "C" fn(libc::c_int) as usize;
                action.sa_flags = libc::SA_RESTART;
                libc::sigaction(signal, &action, std::ptr::null_mut());
            }
        }
    }
}

// SAFETY: the section holds functions that the C library calls before `main`.
#[used]
#[unsafe(link_section = ".init_array")]
static BEFORE_MAIN: extern "C" fn() = give_handlers;
