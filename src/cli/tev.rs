//! Pictures in the making, shown by the viewer tev, or by HDRView, over the network.

use crate::image::{Onlooker, Region};
use crate::run::Job;
use clap::Args;
use std::io::{self, ErrorKind};
use std::net::{TcpStream, ToSocketAddrs};
use std::path::Path;
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tev_client::{PacketCreateImage, PacketUpdateImage, TevClient};

/// How long one waits for a viewer, at the start and when all is sent.
const PATIENCE: Duration = Duration::from_secs(2);

/// Where pictures are shown, as typed.
#[derive(Clone, Debug, Args)]
pub struct TevOptions {
    /// Show the image while it is made in the viewer tev that listens there, as 127.0.0.1:14158. It
    /// is made as ever, after a warning, where nobody listens
    #[arg(long, value_name = "HOST:PORT")]
    tev: Option<String>,
}

impl TevOptions {
    /// Warns before the work where nobody listens.
    pub fn check(&self, job: &Job) {
        if let Some(place) = &self.tev
            && let Err(e) = connect(place)
        {
            job.progress.warn(&format!(
                "no viewer listens at {place} ({e}); the image is made without"
            ));
        }
    }

    /// A viewer with an empty picture of so many pixels; `None` if nobody wants one, or listens.
    pub fn open(
        &self,
        name: &Path,
        size: [u32; 2],
        channels: &'static [&'static str],
    ) -> Option<Tev> {
        let socket = connect(self.tev.as_deref()?).ok()?;
        let (sender, receiver) = channel();
        let picture = Picture {
            name: name.display().to_string().replace('\0', ""),
            size,
            channels,
        };
        let thread = std::thread::Builder::new()
            .name("tev".into())
            .spawn(move || picture.send(TevClient::wrap(socket), &receiver));
        Some(Tev {
            channels: channels.len(),
            sender: Mutex::new(sender),
            thread: thread.ok()?,
        })
    }
}

fn connect(place: &str) -> io::Result<TcpStream> {
    let mut last = io::Error::new(ErrorKind::NotFound, "no such address");
    for address in place.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, PATIENCE) {
            Ok(socket) => {
                socket.set_write_timeout(Some(PATIENCE))?;
                return Ok(socket);
            }
            Err(e) => last = e,
        }
    }
    Err(last)
}

/// A part of a picture, on its way.
struct Part {
    region: Region,
    /// Channel by channel, row by row.
    samples: Vec<f32>,
}

/// A viewer that looks on. What it has not taken yet waits in memory, never the frame for it.
#[derive(Debug)]
pub struct Tev {
    channels: usize,
    sender: Mutex<Sender<Part>>,
    thread: JoinHandle<()>,
}

impl Onlooker for Tev {
    fn see(&self, region: Region, planes: &[Vec<f32>]) {
        let planes = &planes[..self.channels.min(planes.len())];
        let part = Part {
            region,
            samples: planes.concat(),
        };
        if let Ok(sender) = self.sender.lock() {
            // A viewer that has gone is no matter.
            let _ = sender.send(part);
        }
    }
}

impl Tev {
    /// Lets it have the rest, for as long as patience lasts.
    pub fn close(self) {
        drop(self.sender);
        let end = Instant::now() + PATIENCE;
        while !self.thread.is_finished() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// What is shown.
struct Picture {
    name: String,
    size: [u32; 2],
    channels: &'static [&'static str],
}

impl Picture {
    /// Sends parts as they come, until there are no more or the viewer goes.
    fn send(&self, mut client: TevClient, parts: &Receiver<Part>) {
        let created = client.send(PacketCreateImage {
            image_name: &self.name,
            grab_focus: true,
            width: self.size[0],
            height: self.size[1],
            channel_names: self.channels,
        });
        if created.is_err() {
            return;
        }
        let strides = vec![1_u64; self.channels.len()];
        for Part { region, samples } in parts {
            let pixels = region.pixels() as u64;
            let offsets: Vec<u64> = (0..self.channels.len() as u64)
                .map(|c| c * pixels)
                .collect();
            // The packet must not be of another length than it says.
            if samples.len() as u64 != pixels * self.channels.len() as u64 || pixels == 0 {
                continue;
            }
            let sent = client.send(PacketUpdateImage {
                image_name: &self.name,
                grab_focus: false,
                channel_names: self.channels,
                channel_offsets: &offsets,
                channel_strides: &strides,
                x: region.x0,
                y: region.y0,
                width: region.width(),
                height: region.height(),
                data: &samples,
            });
            if sent.is_err() {
                return;
            }
        }
    }
}

/// Names of the channels of the beauty.
#[must_use]
pub fn channels(has_alpha: bool) -> &'static [&'static str] {
    if has_alpha {
        &["R", "G", "B", "A"]
    } else {
        &["R", "G", "B"]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;
    use std::net::TcpListener;

    /// The packets of a stream, without their lengths.
    fn packets(bytes: &[u8]) -> Vec<&[u8]> {
        let mut rest = bytes;
        let mut found = Vec::new();
        while let Some((length, _)) = rest.split_first_chunk::<4>() {
            let (packet, behind) = rest.split_at(u32::from_le_bytes(*length) as usize);
            found.push(&packet[4..]);
            rest = behind;
        }
        found
    }

    #[test]
    fn parts_arrive_as_packets_of_tev() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let options = TevOptions {
            tev: Some(listener.local_addr().unwrap().to_string()),
        };
        let viewer = std::thread::spawn(move || {
            let mut bytes = Vec::new();
            let (mut socket, _) = listener.accept().unwrap();
            socket.read_to_end(&mut bytes).unwrap();
            bytes
        });
        let tev = options
            .open(Path::new("a.exr"), [9, 8], channels(false))
            .unwrap();
        let region = Region {
            x0: 2,
            y0: 3,
            x1: 4,
            y1: 4,
        };
        let planes = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]].map(Vec::from);
        tev.see(region, &planes);
        tev.close();
        let bytes = viewer.join().unwrap();
        let [create, update] = packets(&bytes)[..] else {
            panic!("{bytes:?}");
        };
        let mut expected = b"\x04\x01a.exr\0".to_vec();
        expected.extend([9_u32, 8, 3].map(u32::to_le_bytes).concat());
        expected.extend(b"R\0G\0B\0");
        assert_eq!(create, expected);
        let mut expected = b"\x06\x00a.exr\0\x03\0\0\0R\0G\0B\0".to_vec();
        expected.extend([2_u32, 3, 2, 1].map(u32::to_le_bytes).concat());
        expected.extend([0_u64, 2, 4, 1, 1, 1].map(u64::to_le_bytes).concat());
        expected.extend((1..=6_u8).flat_map(|v| f32::from(v).to_le_bytes()));
        assert_eq!(update, expected);
    }

    #[test]
    fn nobody_there_is_a_warning_and_no_viewer() {
        let options = |tev: &str| TevOptions {
            tev: Some(tev.into()),
        };
        let closed = TcpListener::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap();
        for place in [closed.to_string(), "nonsense".into()] {
            let job = Job::default();
            options(&place).check(&job);
            assert!(job.progress.warnings()[0].contains(&place));
            assert!(
                options(&place)
                    .open(Path::new("a"), [1, 1], channels(true))
                    .is_none()
            );
        }
    }

    #[test]
    fn a_viewer_that_does_not_read_holds_up_nothing() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let place = listener.local_addr().unwrap().to_string();
        let tev = TevOptions { tev: Some(place) };
        let tev = tev
            .open(Path::new("a"), [512, 512], channels(false))
            .unwrap();
        let start = Instant::now();
        let planes = [0; 3].map(|_| vec![1.0; 512 * 512]);
        for _ in 0..8 {
            tev.see(Region::full(512, 512), &planes);
        }
        tev.close();
        assert!(start.elapsed() < 3 * PATIENCE);
    }
}
