//! A loop that is also taken further where something arrived for it: by the thread that brings a frame, when the loop
//! waits for nothing but that. Waking a task on another thread takes longer than most frames need.

use parking_lot::Mutex;
use std::any::Any;
use std::fmt;
use std::future::{Future, poll_fn};
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, Waker};
use tokio::runtime::Handle;
use tracing::Span;

type Work = Pin<Box<dyn Future<Output = ()> + Send>>;

/// The loop that runs now, if any. Clones are of the same.
#[derive(Clone, Default)]
pub(crate) struct InPlace(Arc<Mutex<State>>);

#[derive(Default)]
struct State {
    running: Option<Running>,
    ended: Option<Result<(), Box<dyn Any + Send>>>,
}

struct Running {
    work: Work,
    /// The task's, since it was polled first.
    waker: Option<Waker>,
    runtime: Handle,
    span: Span,
}

impl InPlace {
    /// Runs `work` to its end in the task that calls this, and wherever it is [advanced](Self::advance). Panics in this
    /// task when `work` does, wherever that was. Dropping the future drops `work`.
    pub(crate) async fn run(&self, work: impl Future<Output = ()> + Send + 'static) {
        *self.0.lock() = State {
            running: Some(Running {
                work: Box::pin(work),
                waker: None,
                runtime: Handle::current(),
                span: Span::current(),
            }),
            ended: None,
        };
        let _taken_away = TakenAway(self);
        let ended = poll_fn(|context| {
            let mut state = self.0.lock();
            if let Some(ended) = state.ended.take() {
                return Poll::Ready(ended);
            }
            let Some(running) = &mut state.running else {
                return Poll::Ready(Ok(()));
            };
            match &mut running.waker {
                Some(waker) => waker.clone_from(context.waker()),
                none => *none = Some(context.waker().clone()),
            }
            running.work.as_mut().poll(context).map(Ok)
        });
        if let Err(panic) = ended.await {
            resume_unwind(panic);
        }
    }

    /// Takes the loop as far as it gets, here and now. False when it is at work elsewhere, or there is none: then
    /// whoever has something for it wakes it.
    pub(crate) fn advance(&self) -> bool {
        let Some(mut state) = self.0.try_lock() else {
            return false;
        };
        let Some(Running {
            work,
            waker: Some(waker),
            runtime,
            span,
        }) = &mut state.running
        else {
            return false;
        };
        // Also where it sets a timer or has something decoded on another thread.
        let _runtime = runtime.enter();
        let polled = span.in_scope(|| {
            let mut context = Context::from_waker(waker);
            catch_unwind(AssertUnwindSafe(|| work.as_mut().poll(&mut context)))
        });
        let ended = match polled {
            Ok(Poll::Pending) => return true,
            Ok(Poll::Ready(())) => Ok(()),
            Err(panic) => Err(panic),
        };
        // The task ends as the loop did: whoever watches it sees that.
        let waker = waker.clone();
        state.ended = Some(ended);
        drop(state);
        waker.wake();
        true
    }
}

impl fmt::Debug for InPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("InPlace")
    }
}

/// Takes the loop away when its task ends.
struct TakenAway<'a>(&'a InPlace);

impl Drop for TakenAway<'_> {
    fn drop(&mut self) {
        let running = self.0.0.lock().running.take();
        // Not under the lock: a loop that goes may have much to do.
        drop(running);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::input::{Delivery, Pushed, RingLimits, RingSender, frame_ring};
    use std::thread::{self, ThreadId};
    use std::time::Duration;
    use tokio::sync::{mpsc, oneshot};
    use tokio::task::JoinHandle;
    use tokio::time::timeout;

    const LIMIT: Duration = Duration::from_secs(20);

    /// What a loop took, and where.
    type Told = mpsc::UnboundedReceiver<(u32, ThreadId)>;

    /// A loop over a ring that tells what it took, and where.
    fn start(fails_at: Option<u32>) -> (InPlace, RingSender<u32>, Told, JoinHandle<()>) {
        let (sender, mut ring) = frame_ring(RingLimits::new(Delivery::Newest, 4, 0));
        let (tell, told) = mpsc::unbounded_channel();
        let place = InPlace::default();
        let work = async move {
            while let Some(item) = ring.next().await {
                assert_ne!(Some(item), fails_at, "a bug of the loop");
                // Whatever needs the runtime works where the loop is advanced.
                tokio::task::spawn_blocking(|| ()).await.unwrap();
                tell.send((item, thread::current().id())).unwrap();
            }
        };
        let task = tokio::spawn({
            let place = place.clone();
            async move { place.run(work).await }
        });
        (place, sender, told, task)
    }

    /// As the receiver does it.
    fn bring(place: &InPlace, sender: &RingSender<u32>, item: u32) {
        let (pushed, wake) = sender.push(item);
        assert_eq!(pushed, Pushed::Queued);
        if let Some(wake) = wake
            && !(wake.only_this && place.advance())
        {
            wake.waker.wake();
        }
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 1)]
    async fn what_another_thread_brings_is_taken_in_order_and_none_is_left() {
        let (place, sender, mut told, task) = start(None);
        let bringing = thread::spawn(move || {
            for item in 0..2000 {
                // Without waiting for the loop, up to what the ring holds.
                while sender.waiting() >= 4 {
                    thread::yield_now();
                }
                bring(&place, &sender, item);
            }
            sender.close();
        });
        for item in 0..2000 {
            let (taken, _) = timeout(LIMIT, told.recv()).await.unwrap().unwrap();
            assert_eq!(taken, item);
        }
        bringing.join().unwrap();
        // The ring is closed, so the loop ends.
        timeout(LIMIT, task).await.unwrap().unwrap();
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 1)]
    async fn an_idle_loop_takes_what_arrives_on_the_thread_that_brings_it() {
        let (sender, mut ring) = frame_ring(RingLimits::new(Delivery::Newest, 4, 0));
        let (tell, mut told) = mpsc::unbounded_channel();
        let place = InPlace::default();
        let (idle, is_idle) = oneshot::channel();
        let work = async move {
            let mut idle = Some(idle);
            loop {
                let mut next = std::pin::pin!(ring.next());
                let item = poll_fn(|context| {
                    let polled = next.as_mut().poll(context);
                    if let Some(idle) = idle.take() {
                        let _ = idle.send(());
                    }
                    polled
                });
                match item.await {
                    Some(item) => tell.send((item, thread::current().id())).unwrap(),
                    None => return,
                }
            }
        };
        let task = tokio::spawn({
            let place = place.clone();
            async move { place.run(work).await }
        });
        is_idle.await.unwrap();
        let bringing = thread::spawn(move || {
            // The task may still be on its way out of its first poll.
            while !place.advance() {
                thread::yield_now();
            }
            bring(&place, &sender, 7);
            sender.close();
            thread::current().id()
        });
        let brought_by = bringing.join().unwrap();
        assert_eq!(told.recv().await, Some((7, brought_by)));
        timeout(LIMIT, task).await.unwrap().unwrap();
    }

    #[tokio::test(flavor = "multi_thread", worker_threads = 1)]
    async fn a_panic_where_a_frame_arrived_ends_the_task_and_not_that_thread() {
        let (place, sender, mut told, task) = start(Some(1));
        bring(&place, &sender, 0);
        assert_eq!(timeout(LIMIT, told.recv()).await.unwrap().unwrap().0, 0);
        let bringing = thread::spawn(move || {
            while !place.advance() {
                thread::yield_now();
            }
            bring(&place, &sender, 1);
            place
        });
        let place = bringing
            .join()
            .expect("the thread that brings frames lives");
        let error = timeout(LIMIT, task).await.unwrap().unwrap_err();
        assert!(error.is_panic());
        assert!(!place.advance(), "there is nothing to be advanced any more");
    }

    #[tokio::test]
    async fn a_task_that_is_aborted_takes_its_loop_along() {
        let (place, sender, mut told, task) = start(None);
        bring(&place, &sender, 0);
        timeout(LIMIT, told.recv()).await.unwrap().unwrap();
        task.abort();
        assert!(
            timeout(LIMIT, task)
                .await
                .unwrap()
                .unwrap_err()
                .is_cancelled()
        );
        assert_eq!(sender.push(1).0, Pushed::Closed(1));
        assert!(!place.advance());
    }
}
