//! What this machine can draw with, asked before an app is built: Bevy ends the process when there is no adapter.

use bevy::tasks::block_on;

/// Why nothing can be drawn or shown.
#[derive(Debug, thiserror::Error)]
pub enum AdapterError {
    /// wgpu found no adapter.
    #[error("no graphics adapter: {0}; install a Vulkan driver (in software: mesa-vulkan-drivers), or run without pictures")]
    NoAdapter(String),
    /// There is no display to open a window on.
    #[error("no display: {0}; set DISPLAY to an X server (in memory: xvfb-run -a), or run without a window")]
    NoDisplay(String),
}

/// Asks for an adapter the way Bevy will and describes it: name, backend, driver.
///
/// # Errors
/// When there is none.
pub fn adapter_available() -> Result<String, AdapterError> {
    if wgpu::Instance::enabled_backend_features().is_empty() {
        return Err(AdapterError::NoAdapter("this program was built without a graphics backend".into()));
    }
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle_from_env());
    let adapter =
        block_on(instance.request_adapter(&wgpu::RequestAdapterOptions::default())).map_err(|e| AdapterError::NoAdapter(e.to_string()))?;
    let info = adapter.get_info();
    Ok(format!("{} ({}, {} {})", info.name, info.backend, info.driver, info.driver_info))
}

/// Whether a window can be opened: on Linux whether `DISPLAY` names an X server that answers, elsewhere always.
///
/// # Errors
/// When it cannot.
pub fn display_available() -> Result<(), AdapterError> {
    if cfg!(target_os = "linux") { x_server_answers(std::env::var("DISPLAY").ok().as_deref()) } else { Ok(()) }
}

#[cfg(target_os = "linux")]
fn x_server_answers(display: Option<&str>) -> Result<(), AdapterError> {
    use std::os::linux::net::SocketAddrExt;
    use std::os::unix::net::{SocketAddr, UnixStream};
    let name = display.filter(|d| !d.is_empty()).ok_or_else(|| AdapterError::NoDisplay("the variable DISPLAY is not set".into()))?;
    // A name without a host is a socket on this machine; another machine's is left to the window system.
    let Some(number) = name.strip_prefix(':').and_then(|n| n.split('.').next()) else { return Ok(()) };
    let path = format!("/tmp/.X11-unix/X{number}");
    let abstract_socket = SocketAddr::from_abstract_name(&path).and_then(|a| UnixStream::connect_addr(&a));
    abstract_socket
        .or_else(|_| UnixStream::connect(&path))
        .map(drop)
        .map_err(|e| AdapterError::NoDisplay(format!("DISPLAY is {name}, but no X server answers at {path} ({e})")))
}

#[cfg(not(target_os = "linux"))]
fn x_server_answers(_display: Option<&str>) -> Result<(), AdapterError> {
    Ok(())
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    #[test]
    fn a_missing_display_says_what_is_missing() {
        for display in [None, Some("")] {
            assert!(matches!(x_server_answers(display), Err(AdapterError::NoDisplay(why)) if why.contains("not set")));
        }
        assert!(matches!(x_server_answers(Some(":65000")), Err(AdapterError::NoDisplay(why)) if why.contains(":65000")));
        assert!(x_server_answers(Some("elsewhere:0")).is_ok());
    }
}
