//! A mapped file that was cut: the system sends SIGBUS to whoever touches what is gone.

#[cfg(not(target_os = "linux"))]
pub fn install() {}

#[cfg(target_os = "linux")]
pub use linux::install;

#[cfg(target_os = "linux")]
mod linux {
    use super::super::{Line, end};
    use crate::formats::emergency::{PATH_BYTES, mapped_path};
    use libc::{c_int, c_void, siginfo_t};
    use std::sync::OnceLock;

    /// What was there before: the standard library tells overflows of the stack.
    static BEFORE: OnceLock<libc::sigaction> = OnceLock::new();

    /// From here on a fault in a mapped file that lvox knows ends the program with a line that
    /// names it; other faults go where they went.
    #[allow(unsafe_code)]
    pub fn install() {
        // The handler runs on the stack of the thread: a fault in a file comes from code that has a
        // stack left, and the small one for overflows is too small for a path.
        // SAFETY: both structures are valid, zeros are a valid `sigaction`, and the handler does
        // only what may be done in one. `BEFORE` is set before it can run.
        unsafe {
            let mut before: libc::sigaction = std::mem::zeroed();
            if libc::sigaction(libc::SIGBUS, std::ptr::null(), &raw mut before) != 0 {
                return;
            }
            if BEFORE.set(before).is_err() {
                return;
            }
            let mut action: libc::sigaction = std::mem::zeroed();
            let handler: extern "C" fn(c_int, *mut siginfo_t, *mut c_void) = on_bus_error;
            action.sa_sigaction = handler as usize;
            action.sa_flags = libc::SA_SIGINFO;
            libc::sigaction(libc::SIGBUS, &raw const action, std::ptr::null_mut());
        }
    }

    #[allow(unsafe_code)]
    extern "C" fn on_bus_error(signal: c_int, info: *mut siginfo_t, context: *mut c_void) {
        // SAFETY: the system passes a valid structure, which for this signal holds an address.
        let address = unsafe { (*info).si_addr() } as usize;
        let mut path = [0; PATH_BYTES];
        if let Some(path) = mapped_path(address, &mut path) {
            let mut line = Line::new();
            line.push(b"error: ");
            line.push(path);
            line.push(
                b": the file was cut or its disk failed while it was read; make it anew, or \
                  start again when it is whole",
            );
            end(line);
        }
        let Some(before) = BEFORE.get() else { return };
        // SAFETY: this is what the system would have called with these arguments. A default action
        // is put back, and the fault comes again when this returns.
        unsafe {
            match before.sa_sigaction {
                libc::SIG_DFL | libc::SIG_IGN => {
                    libc::sigaction(signal, before, std::ptr::null_mut());
                }
                handler if before.sa_flags & libc::SA_SIGINFO != 0 => {
                    let handler: extern "C" fn(c_int, *mut siginfo_t, *mut c_void) =
                        std::mem::transmute(handler);
                    handler(signal, info, context);
                }
                handler => {
                    let handler: extern "C" fn(c_int) = std::mem::transmute(handler);
                    handler(signal);
                }
            }
        }
    }
}
