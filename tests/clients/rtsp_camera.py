"""A network camera: serves moving pictures over RTSP on the loopback interface until its standard input closes.

Usage: rtsp_camera.py PORT CODEC [USER PASSWORD]

CODEC is h264 or jpeg. The stream is at rtsp://127.0.0.1:PORT/stream, over TCP only, as for cameras behind a firewall.
Prints "ready" once it listens. Debian: python3-gi, gir1.2-gst-rtsp-server-1.0, gstreamer1.0-plugins-good and -ugly.
"""

import sys
import threading

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtsp", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtsp, GstRtspServer  # noqa: E402

PICTURES = "videotestsrc is-live=true pattern=ball ! video/x-raw,width=320,height=180,framerate=25/1 ! videoconvert"
CODECS = {
    "h264": "x264enc tune=zerolatency speed-preset=ultrafast key-int-max=25 ! rtph264pay name=pay0 pt=96",
    "jpeg": "video/x-raw,format=I420 ! jpegenc ! rtpjpegpay name=pay0 pt=26",
}


def main():
    port, codec, *login = sys.argv[1:]
    Gst.init(None)
    server = GstRtspServer.RTSPServer()
    server.set_address("127.0.0.1")
    server.set_service(port)
    factory = GstRtspServer.RTSPMediaFactory()
    factory.set_launch(f"( {PICTURES} ! {CODECS[codec]} )")
    factory.set_protocols(GstRtsp.RTSPLowerTrans.TCP)
    if login:
        user, password = login
        token = GstRtspServer.RTSPToken()
        token.set_string("media.factory.role", "viewer")
        auth = GstRtspServer.RTSPAuth()
        auth.add_basic(GstRtspServer.RTSPAuth.make_basic(user, password), token)
        server.set_auth(auth)
        permissions = GstRtspServer.RTSPPermissions()
        permissions.add_permission_for_role("viewer", "media.factory.access", True)
        permissions.add_permission_for_role("viewer", "media.factory.construct", True)
        factory.set_permissions(permissions)
    server.get_mount_points().add_factory("/stream", factory)
    if server.attach(None) == 0:
        sys.exit(f"port {port} cannot be listened on")
    loop = GLib.MainLoop()

    def until_the_input_ends():
        sys.stdin.read()
        GLib.idle_add(loop.quit)

    threading.Thread(target=until_the_input_ends, daemon=True).start()
    print("ready", flush=True)
    loop.run()


main()
