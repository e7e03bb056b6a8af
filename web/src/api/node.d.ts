// Made by `npm run types` from api/node.json. Do not edit.

export interface paths {
    "/api/v1": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Service, version and list of routes
         * @description `curl http://127.0.0.1:8080/api/v1`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Index"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/caller": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The caller and its permissions
         * @description Open to all: it says what a token allows, or that one is needed.
         *     `curl -H "Authorization: Bearer $TOKEN" http://127.0.0.1:8080/api/v1/caller`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["WhoAsks"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/cameras": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The cameras
         * @description `curl http://127.0.0.1:8080/api/v1/cameras`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Cameras"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/cameras/{camera}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * State of a camera: policy, threshold, frame states, suggestions
         * @description `curl http://127.0.0.1:8080/api/v1/cameras/front`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description The camera's name. */
                    camera: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["CameraEntry"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/cameras/{camera}/detections": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The detections of a camera's newest frame
         * @description The message as published on Zenoh; 404 before the first frame.
         *     `curl http://127.0.0.1:8080/api/v1/cameras/front/detections`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description The camera's name. */
                    camera: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["DetectionsMessage"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/cameras/{camera}/frame-states": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The frame-state counters of a camera
         * @description `curl http://127.0.0.1:8080/api/v1/cameras/front/frame-states`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description The camera's name. */
                    camera: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["CameraStates"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/cameras/{camera}/frame.jpg": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The latest picture received from a camera
         * @description The header `albireo-frame` has the sequence number of the frame.
         *     `curl -o frame.jpg 'http://127.0.0.1:8080/api/v1/cameras/front/frame.jpg?boxes=true'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description True for the newest answered picture with its boxes: solid where detected, dashed where predicted. */
                    boxes?: boolean;
                };
                header?: never;
                path: {
                    /** @description The camera's name. */
                    camera: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        /** @description Sequence number of the frame. */
                        "albireo-frame"?: number;
                        [name: string]: unknown;
                    };
                    content: {
                        "image/jpeg": number[];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/cameras/{camera}/history": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * A camera's last minutes frame by frame, and its last hour in pieces
         * @description The node always keeps the newest 8192 frames and 360 pieces of ten seconds in memory.
         *     `curl 'http://127.0.0.1:8080/api/v1/cameras/front/history?frames=100'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Maximum number of frames, 0 to 8192; 3000 by default. */
                    frames?: number;
                };
                header?: never;
                path: {
                    /** @description The camera's name. */
                    camera: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["CameraHistory"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/cameras/{camera}/skip-estimate": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The frames that other thresholds would have skipped over the last minutes
         * @description An estimate from the uncertainties that were recorded frame by frame, for the threshold `u`; 409 for another
         *     threshold, and while nothing is recorded.
         *     `curl 'http://127.0.0.1:8080/api/v1/cameras/front/skip-estimate?values=1e-4,3e-4,1e-3'`
         */
        get: {
            parameters: {
                query?: {
                    /**
                     * @description Values of the threshold, separated by commas, at most 64; by default 41, from a hundredth of the default threshold to a
                     *     hundred times it.
                     */
                    values?: string;
                };
                header?: never;
                path: {
                    /** @description The camera's name. */
                    camera: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["SkipEstimates"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/cameras/{camera}/stream.mjpg": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * A camera's pictures with boxes, as motion JPEG
         * @description For whatever shows a camera by its address: a browser, Home Assistant, VLC, ffmpeg. A slow reader gets fewer pictures,
         *     never old ones; each picture is drawn once for all readers. Boxes are solid where detected, dashed where predicted.
         *     While no frame arrives, none is sent. 503 while 16 streams are open.
         *     `curl -N -o front.mjpg 'http://127.0.0.1:8080/api/v1/cameras/front/stream.mjpg?rate=5'` keeps it; players show it:
         *     `ffplay 'http://127.0.0.1:8080/api/v1/cameras/front/stream.mjpg?rate=5'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Pictures per second at most, 1 to 30; 10 by default. */
                    rate?: number;
                };
                header?: never;
                path: {
                    /** @description The camera's name. */
                    camera: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description JPEG files; `albireo-frame` of each part is the sequence number of the frame. */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "multipart/x-mixed-replace": number[];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/cameras/{camera}/threshold": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * A camera's threshold in force
         * @description `curl http://127.0.0.1:8080/api/v1/cameras/front/threshold`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description The camera's name. */
                    camera: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["CameraThreshold"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        /**
         * Changes a camera's threshold
         * @description Applies from the camera's next frame.
         *     `curl -X PUT -d '{"u": 5e-4}' http://127.0.0.1:8080/api/v1/cameras/front/threshold`
         */
        put: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description The camera's name. */
                    camera: string;
                };
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["NewThreshold"];
                };
            };
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["CameraThreshold"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/clips": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Recent clip reports, newest first
         * @description The node keeps the newest 256 in memory. `before` and `after` take the `id` of a report.
         *     `curl 'http://127.0.0.1:8080/api/v1/clips?camera=front&limit=10'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Only reports of this camera. */
                    camera?: string;
                    /** @description Maximum number; 50 by default. */
                    limit?: number;
                    /** @description Only reports older than the one with this id: for earlier clips, the `next` of the previous answer. */
                    before?: string;
                    /** @description Only reports newer than the one with this id: for later clips, the id of the newest known report. */
                    after?: string;
                };
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Clips"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/diag": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Diagnostics as one tar archive
         * @description Versions, the configuration with its secrets masked, readiness with reasons, cameras, frame-state counters, metrics, the
         *     last clips, and the last lines of the log. `curl -O -J http://127.0.0.1:8080/api/v1/diag`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/x-tar": number[];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/events": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The node's events, as server-sent events
         * @description First the present state (counters, thresholds, detector), then each change. A reader that is too slow
         *     loses events; the event `lagged` reports how many. With 64 streams open, the oldest ends for a new one.
         *     `curl -N 'http://127.0.0.1:8080/api/v1/events?types=counters,clip'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Only events of this camera, and of the detector. */
                    camera?: string;
                    /**
                     * @description Only these kinds, separated by commas: `frame`, `late`, `sighting`, `clip`, `counters`, `threshold`,
                     *     `detector`. All kinds by default.
                     */
                    types?: string;
                };
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description Events `frame`, `late`, `sighting`, `clip`, `counters`, `threshold`, `detector`, `lagged`. */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "text/event-stream": string;
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/frame-states": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The frame-state counters of all cameras
         * @description `curl http://127.0.0.1:8080/api/v1/frame-states`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["NodeStates"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/log": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The last lines of the log
         * @description The node keeps the newest 1000 lines of level `info` and above in memory, regardless of the level on standard error.
         *     Configured secrets are masked. `curl 'http://127.0.0.1:8080/api/v1/log?limit=20'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Only lines after the one with this number. */
                    after?: number;
                    /** @description Maximum number of lines, the newest ones, 1 to 1000; 200 by default. */
                    limit?: number;
                };
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Log"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/node": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The node in one answer
         * @description Like `/readyz`, but always with status 200: it is for display, not for probes.
         *     `curl http://127.0.0.1:8080/api/v1/node`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["NodeOverview"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/policy": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The policy in force
         * @description `curl http://127.0.0.1:8080/api/v1/policy`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["PolicyInForce"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        /**
         * Switches the policy of all cameras
         * @description Applies from each camera's next frame, which begins as at the start of a stream: the objects of the policy before are
         *     forgotten, and its clip ends there and is reported under its name. The threshold is the one that is configured for the new
         *     policy. A target is held from there, if the new policy has a threshold for it.
         *     `curl -X PUT -d '{"name": "expected-loss"}' http://127.0.0.1:8080/api/v1/policy`
         */
        put: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["PolicyChoice"];
                };
            };
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["PolicyInForce"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/power": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The node's power over the last hour, in pieces
         * @description `curl http://127.0.0.1:8080/api/v1/power`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["PowerHistory"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/recordings": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The recordings
         * @description `curl http://127.0.0.1:8080/api/v1/recordings`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["RecordingStatus"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        /**
         * Records what happens now
         * @description Keeps the last `record.before_s` seconds and the next `record.after_s` of one camera or of all; a request while a
         *     recording runs prolongs it. Answers 409 if the node has no `record.folder`.
         *     `curl -X PUT -d '{"reason": "braking"}' http://127.0.0.1:8080/api/v1/recordings`
         */
        put: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["NewRecording"];
                };
            };
            responses: {
                202: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["RecordingStatus"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/screen": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The pause on an empty road
         * @description `curl http://127.0.0.1:8080/api/v1/screen`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Pause"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        /**
         * Changes the pause on an empty road, of all cameras
         * @description Applies from each camera's next frame. Once nothing was detected for `after_s`, one frame per `pause_s` is looked at
         *     until something is found; the others are answered with state E. With `still_s`, one frame per so many seconds is looked at
         *     while the picture does not change.
         *     `curl -X PUT -d '{"pause_s": 0.2}' http://127.0.0.1:8080/api/v1/screen`
         */
        put: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["Pauses"];
                };
            };
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Pause"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/target": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The target and its state
         * @description `curl http://127.0.0.1:8080/api/v1/target`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["TargetReport"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        /**
         * Sets a target instead of a threshold
         * @description One of `recall` (against the detector, the lower end of its interval), `skip_rate` and `watts`, or null for none. A
         *     controller then moves the threshold of all cameras together, inside its range; setting the threshold by hand
         *     switches it off.
         *     `curl -X PUT -d '{"target": {"skip_rate": 0.5}}' http://127.0.0.1:8080/api/v1/target`
         */
        put: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["TargetMessage"];
                };
            };
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["TargetReport"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/threshold": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The thresholds in force
         * @description `curl http://127.0.0.1:8080/api/v1/threshold`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Thresholds"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        /**
         * Changes the threshold of all cameras, or of none
         * @description Applies from each camera's next frame. The threshold has the policy's name for it: `u`, or `lambda` under
         *     expected-loss.
         *     `curl -X PUT -d '{"u": 5e-4}' http://127.0.0.1:8080/api/v1/threshold`
         */
        put: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["NewThreshold"];
                };
            };
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Thresholds"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/healthz": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Liveness: the process answers
         * @description Touches neither the detector nor the GPU. `curl http://127.0.0.1:8080/healthz`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Health"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/metrics": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Metrics for Prometheus
         * @description `curl http://127.0.0.1:8080/metrics`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "text/plain": string;
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/readyz": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Readiness: frames are answered, and by which execution provider
         * @description 503 while starting and when an essential part fails; 200 with reasons when another part fails.
         *     `curl http://127.0.0.1:8080/readyz`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Readiness"];
                    };
                };
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["NotReady"];
                    };
                };
                "4XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
                "5XX": {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
                    };
                };
            };
        };
        put?: never;
        post?: never;
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
}
export type webhooks = Record<string, never>;
export interface components {
    schemas: {
        /** @description A policy that has skipped nothing, and a value to try. */
        Advice: {
            /**
             * Format: int64
             * @description The number of these frames with objects.
             */
            followed: number;
            /**
             * Format: int64
             * @description Frames since the last change of the threshold; the detector ran on every one.
             */
            frames: number;
            /** @description The threshold's name. */
            threshold: string;
            /**
             * Format: double
             * @description A value under which about half of those frames would have been predicted.
             */
            try: number;
            /**
             * Format: double
             * @description Its value.
             */
            value: number;
        };
        /**
         * @description The results of an audit, with 95 % intervals that account for missed frames. The reference is the detector, not the
         *     truth: a policy that keeps showing an object that the detector misses loses precision here although it may be right.
         */
        AuditFigures: {
            /**
             * Format: int64
             * @description Detector calls for the audit.
             */
            calls: number;
            /**
             * Format: int64
             * @description Boxes that the detector found on the compared frames.
             */
            detected: number;
            /**
             * Format: double
             * @description Detector time of these calls, seconds.
             */
            detector_s: number;
            /**
             * Format: int64
             * @description Skipped frames drawn for the audit.
             */
            drawn: number;
            /**
             * Format: int64
             * @description Drawn frames that the detector had no time for.
             */
            missed: number;
            precision?: components["schemas"]["AuditRate"] | null;
            recall?: components["schemas"]["AuditRate"] | null;
            /**
             * Format: int64
             * @description Boxes shown on the compared frames.
             */
            shown: number;
        };
        /** @description A share of boxes with its 95 % confidence interval. */
        AuditRate: {
            /**
             * Format: int64
             * @description Number of compared boxes.
             */
            boxes: number;
            /**
             * Format: double
             * @description Upper end of the interval: the same, with every box of the missed frames counted as a success.
             */
            high: number;
            /**
             * Format: double
             * @description Equivalent number of independent boxes: the boxes of one frame are shown or missed together.
             */
            independent: number;
            /**
             * Format: double
             * @description Lower end of the interval: the Wilson interval of the sample, with every box of the missed frames counted as a
             *     failure.
             */
            low: number;
            /**
             * Format: double
             * @description The share on the compared frames, 0 to 1.
             */
            rate: number;
        };
        /**
         * @description The audit part of a clip report: results for skipped frames since the previous report. A frame at the end of a clip
         *     may be counted in the next report.
         */
        AuditReport: {
            /**
             * Format: int64
             * @description Detector calls for the audit; included in neither the frame states nor the skip rate.
             * @default 0
             */
            calls: number;
            /**
             * Format: int64
             * @description Detector time of these calls, microseconds.
             * @default 0
             */
            detector_us: number;
            /**
             * Format: double
             * @description Estimated energy of these calls, joules, included in the clip's energy: the watts that a running detector adds
             *     on this machine times `detector_us`. Absent while those watts are unknown.
             * @default null
             */
            joules: number | null;
            /**
             * Format: double
             * @description Share of skipped frames drawn for the audit.
             * @default 0
             */
            share: number;
            /**
             * @description Counts of compared and missed frames.
             * @default {}
             */
            sums: components["schemas"]["AuditSums"];
        };
        /** @description Sums over the compared frames of the squares and products of their counts, from which the intervals are computed. */
        AuditSquares: {
            /**
             * Format: int64
             * @description Detected boxes, squared.
             * @default 0
             */
            detected: number;
            /**
             * Format: int64
             * @description Detected boxes times pairs.
             * @default 0
             */
            detected_paired: number;
            /**
             * Format: int64
             * @description Pairs, squared.
             * @default 0
             */
            paired: number;
            /**
             * Format: int64
             * @description Shown boxes, squared.
             * @default 0
             */
            shown: number;
            /**
             * Format: int64
             * @description Shown boxes times pairs.
             * @default 0
             */
            shown_paired: number;
        };
        /**
         * @description Sums over the drawn frames. A pooled rate covers all compared boxes: of two cameras with equally many boxes per
         *     frame, the one that audits the larger share of its frames weighs more.
         */
        AuditSums: {
            /**
             * Format: int64
             * @description Boxes that the detector found on the compared frames.
             * @default 0
             */
            detected: number;
            /**
             * Format: int64
             * @description Frames compared.
             * @default 0
             */
            frames: number;
            /**
             * Format: int64
             * @description Drawn frames that the detector had no time for.
             * @default 0
             */
            missed: number;
            /**
             * Format: int64
             * @description Boxes shown on the missed frames, at least one per frame: the weight of missed frames in an interval.
             * @default 0
             */
            missed_boxes: number;
            /**
             * Format: int64
             * @description Pairs of a detected and a shown box of the same object.
             * @default 0
             */
            paired: number;
            /**
             * Format: int64
             * @description Boxes shown on the compared frames.
             * @default 0
             */
            shown: number;
            /**
             * @description Sums of squares and products of the counts, for the intervals.
             * @default {
             *       "detected": 0,
             *       "detected_paired": 0,
             *       "paired": 0,
             *       "shown": 0,
             *       "shown_paired": 0
             *     }
             */
            squares: components["schemas"]["AuditSquares"];
        };
        /** @description The state of the board during a clip, as far as the board reports it. A clip's energy depends on it. */
        BoardState: {
            /**
             * Format: double
             * @description Mean clock of the CPU cores, MHz.
             * @default null
             */
            cpu_mhz: number | null;
            /**
             * Format: double
             * @description Mean clock of the GPU, MHz.
             * @default null
             */
            gpu_mhz: number | null;
            /**
             * Format: double
             * @description Mean share of the time in which the GPU was busy, 0 to 1; of several, the busiest.
             * @default null
             */
            gpu_utilisation: number | null;
            /**
             * Format: double
             * @description Highest temperature of any sensor, °C.
             * @default null
             */
            hottest_celsius: number | null;
            /**
             * @description The sensor with the highest temperature.
             * @default null
             */
            hottest_sensor: string | null;
            /**
             * @description Power mode: its `nvpmodel` name, else the ACPI platform profile. If it changed, all modes in order.
             * @default null
             */
            power_mode: string | null;
            /**
             * @description True if heat, current or power throttled the clocks at any time; absent if the board does not report it.
             * @default null
             */
            throttled: boolean | null;
        };
        /** @description One box of a [`DetectionsMessage`]. */
        BoxMessage: {
            /** @description Left, top, right, bottom in pixels of the source picture, clipped to it. */
            box: number[];
            /** @description Name of the class. */
            class: string;
            /**
             * Format: float
             * @description Confidence, 0 to 1.
             */
            confidence: number;
            /** @description True if the object is confirmed. */
            confirmed: boolean;
            object?: components["schemas"]["ObjectId"] | null;
            /** @description How the policy knows of the box. */
            source: components["schemas"]["BoxSource"];
        };
        /**
         * @description The source of a reported box.
         * @enum {string}
         */
        BoxSource: "detected" | "predicted" | "followed" | "rescued";
        /**
         * @description The reason why the detector was called for a frame, even if it did not answer. If several apply, the first in this
         *     list is reported.
         * @enum {string}
         */
        CallCause: "uncertain" | "new_object" | "expected_loss" | "object_cap" | "periodic_cap" | "screen" | "audit" | "empty_limit" | "empty_road" | "no_objects" | "start" | "retry" | "changed" | "schedule" | "every_frame" | "joined";
        /** @description A camera. */
        CameraEntry: components["schemas"]["CameraStates"] & {
            advice?: components["schemas"]["Advice"] | null;
            /**
             * Format: int64
             * @description Frames that came from it since the node started, also those that `max_rate` leaves out.
             */
            arrived: number;
            /**
             * Format: int64
             * @description Frames of these that show damage: from a complaint of the decoder to the next whole key frame.
             */
            broken: number;
            /**
             * Format: int64
             * @description Clips ended since the node started.
             */
            clips: number;
            /** @description What is wrong: why no frames arrive, or why those that arrive are of no use; absent if all is well. */
            fault?: string | null;
            /**
             * Format: int32
             * @description Rows of its newest frame.
             */
            height?: number | null;
            /** @description Zenoh key of its frames; absent if it has a source. */
            key?: string | null;
            /** @description The last of these files, and why. */
            last_passed_over?: string | null;
            /**
             * Format: double
             * @description Frames per second that the node takes from its source at most; absent without a limit.
             */
            max_rate?: number | null;
            no_news?: components["schemas"]["NoNews"] | null;
            /**
             * Format: int64
             * @description Video files of its source that could not be played and were passed over.
             */
            passed_over: number;
            /** @description The policy that decides its frames. */
            policy: string;
            /** @description Who chose this policy: `local` where it was switched at the node. */
            policy_set_by: components["schemas"]["SettingSource"];
            /**
             * Format: double
             * @description Frames per second that come from it, over the last 10 s.
             */
            rate?: number | null;
            set_by?: components["schemas"]["SettingSource"] | null;
            /** @description Address of the source that the node opens for it, without credentials. */
            source?: string | null;
            threshold_spec?: components["schemas"]["ThresholdSpec"] | null;
            /**
             * Format: double
             * @description The equivalent of `u` in the published code, for pictures of this size; absent if it is the same number, before the
             *     first frame, and under other policies.
             */
            u_as_published?: number | null;
            /** @description True if the last frames that arrived could all not be used; `fault` says why. */
            unusable: boolean;
            /**
             * Format: int32
             * @description Columns of its newest frame.
             */
            width?: number | null;
        };
        /** @description Recent frames of a camera. */
        CameraHistory: {
            /** @description Camera. */
            camera: string;
            /** @description The last frames. */
            frames: components["schemas"]["PastFrames"];
            /**
             * Format: int64
             * @description The node's clock now, milliseconds since the Unix epoch.
             */
            now_ms: number;
            /**
             * @description How many of the last of these the policy in force decided: the uncertainties and thresholds of others are those of another
             *     policy.
             */
            of_policy: number;
            /**
             * Format: int64
             * @description Length of a piece of the hour, seconds.
             */
            slot_s: number;
            /** @description The last hour in pieces, the oldest first, the last one still open; pieces without a frame are left out. */
            slots: components["schemas"]["CameraSlot"][];
        };
        /** @description What the pause means for a camera. */
        CameraPause: {
            /** @description Camera. */
            camera: string;
            /**
             * Format: double
             * @description Its measured frames per second; absent before its second frame.
             */
            frames_per_second?: number | null;
            /**
             * Format: int32
             * @description On an empty road, one frame in this many is looked at: 1 if the pause is shorter than two frames at this rate.
             */
            looks_at_one_in: number;
        };
        /** @description A piece of the last hour. */
        CameraSlot: {
            /**
             * Format: int64
             * @description Its start, milliseconds since the Unix epoch.
             */
            at_ms: number;
            /**
             * Format: int32
             * @description Frames for which the detector was called.
             */
            calls: number;
            /**
             * Format: int32
             * @description Frames answered from prediction because the detector was not available.
             */
            degraded: number;
            /**
             * Format: float
             * @description Median time of the detector, milliseconds; absent where it did not run.
             */
            detector_p50_ms?: number | null;
            /**
             * Format: float
             * @description 99th percentile of it.
             */
            detector_p99_ms?: number | null;
            /**
             * Format: int32
             * @description Frames processed.
             */
            frames: number;
            /**
             * Format: int32
             * @description Frames that skipped the detector: state E or P and not degraded.
             */
            skipped: number;
        };
        /**
         * @description The state of a camera's frames.
         * @enum {string}
         */
        CameraState: "live" | "stale" | "never_seen";
        /** @description Frames of a camera since the node started. */
        CameraStates: components["schemas"]["FrameCounts"] & {
            /** @description Camera. */
            camera: string;
            /** @description Frames not processed, by kind. */
            dropped: components["schemas"]["DroppedFrames"];
            /**
             * Format: double
             * @description Seconds since the newest frame; absent before the first.
             */
            last_frame_age_s?: number | null;
            /**
             * Format: double
             * @description Largest uncertainty of the newest frame; absent without objects.
             */
            tau_max?: number | null;
            threshold?: components["schemas"]["Threshold"] | null;
        };
        /** @description One camera of a [`NodeStatus`]. */
        CameraStatus: {
            /** @description Name of the camera. */
            name: string;
            /** @description State of its frames. */
            state: components["schemas"]["CameraState"];
            threshold?: components["schemas"]["Threshold"] | null;
            /** @description Origin of the threshold. */
            threshold_source: components["schemas"]["SettingSource"];
        };
        /** @description One camera's threshold. */
        CameraThreshold: {
            /** @description Camera. */
            camera: string;
            /** @description True if what was set at run time survives a restart: a `state_dir` is set, and the settings are written there. */
            survives_restart: boolean;
            threshold_spec?: components["schemas"]["ThresholdSpec"] | null;
        };
        /** @description The cameras of a node. */
        Cameras: {
            /** @description In the order of the configuration. */
            cameras: components["schemas"]["CameraEntry"][];
        };
        /** @description How long a certificate is valid. */
        CertificateStatus: {
            /** @description The key that names its file: `uplink.certificate`. */
            name: string;
            /**
             * Format: int64
             * @description Its end, seconds since the Unix epoch.
             */
            until_s: number;
        };
        /**
         * @description The reason why a clip ended.
         * @enum {string}
         */
        ClipEnd: "next_clip" | "window" | "silence" | "shutdown" | "length" | "policy" | "other";
        /**
         * @description Energy of one clip.
         *
         *     Joules count only the time covered by samples; `coverage` is its share of the clip. They are never extrapolated, so
         *     with a coverage below [`FULL_COVERAGE`] (0.999) they are less than the clip used: do not compare them with other
         *     joules or divide them by the clip's duration. `edp` is then absent.
         */
        ClipEnergy: {
            /**
             * Format: double
             * @description Share of the clip's time covered by samples, 0 to 1.
             */
            coverage: number;
            /** @description Energy of the node by domain. */
            domains: components["schemas"]["DomainEnergy"][];
            /**
             * Format: double
             * @description Energy-delay product, J·ms/frame: clip energy × clip duration ÷ frames (paper, evaluation). Absent without
             *     frames and if samples do not cover the whole clip (`coverage` below 0.999).
             */
            edp?: number | null;
            /**
             * Format: double
             * @description The clip's energy, joules: its share of `node_joules` by detector time used for its camera; absent if
             *     [`EnergyQuality::Unavailable`].
             */
            joules?: number | null;
            /**
             * Format: double
             * @description Energy of the whole node over the same time, joules, including this clip's share `joules`. Equal to `joules` if
             *     the node has one camera.
             */
            node_joules?: number | null;
            /** @description Quality of the figures. */
            quality: components["schemas"]["EnergyQuality"];
            /**
             * Format: int64
             * @description Number of samples inside the clip.
             */
            samples: number;
            /**
             * Format: double
             * @description Estimated joules that this clip's avoided detector calls would have added: their run time, at most the
             *     detector's idle time, times the watts that a running detector adds on this machine. Absent until those watts are
             *     known.
             */
            saved_joules_estimated?: number | null;
            /** @description Source of the figures: `rapl`, `estimate`, … */
            source: string;
            /**
             * @description What `joules` of the total domain includes: `input_rail` for the whole machine, `sum_of_rails` of a board, the
             *     parts in words (`processor + card`; `processor, without card`), or the estimate's formula.
             */
            total_from: string;
        };
        /** @description The report of one clip. */
        ClipReport: {
            audit?: components["schemas"]["AuditReport"] | null;
            board?: components["schemas"]["BoardState"] | null;
            /** @description Name of the camera. */
            camera: string;
            /** @description Clip id: the camera's own, or `window-N`. */
            clip: string;
            /**
             * Format: int64
             * @description Running number of the node's reports: gaps show how many are missing. Absent if the node could not read the last
             *     number. The id does not depend on it.
             */
            count?: number | null;
            /**
             * Format: int64
             * @description Frames answered by prediction because the detector was not available: state P, not counted as skipped.
             */
            degraded_frames: number;
            /** @description Latency of the detector alone, over the frames on which it ran. */
            detector_latency_ms: components["schemas"]["Percentiles"];
            /**
             * Format: double
             * @description Detector run time for this clip's frames, milliseconds, excluding waiting and the audit. The time of a batched
             *     run is divided evenly among its pictures.
             */
            detector_used_ms?: number;
            /** @description Frames not processed, by kind. */
            dropped: components["schemas"]["DroppedFrames"];
            /**
             * Format: double
             * @description Seconds from the first frame's arrival to the clip's end.
             */
            duration_s: number;
            /** @description The reason why the clip ended. */
            ended_by: components["schemas"]["ClipEnd"];
            /** @description Energy that the clip used, as far as a meter or an estimate knows it. */
            energy: components["schemas"]["ClipEnergy"];
            /**
             * Format: int64
             * @description Frames processed: the sum of the five states.
             */
            frames: number;
            /**
             * Format: uuid
             * @description Id, a UUID of version 7 from the node's clock; it never changes.
             */
            id: string;
            /** @description File name of the detector model. */
            model: string;
            /** @description Name of the node. */
            node: string;
            /**
             * Format: int32
             * @description Part number, from 0: a long clip is reported in parts, and so is one in which the policy was switched.
             */
            part?: number;
            /** @description Name of the policy. */
            policy: string;
            /** @description Execution provider that ran the model. */
            provider: string;
            /**
             * Format: double
             * @description Share of frames that skipped the detector: state E or P and not degraded.
             */
            skip_rate: number;
            /**
             * Format: int64
             * @description Capture time of the first frame, nanoseconds since the Unix epoch.
             */
            started_ns: number;
            /** @description Frames in each of the five states. */
            states: components["schemas"]["FrameStates"];
            target?: components["schemas"]["Target"] | null;
            threshold?: components["schemas"]["Threshold"] | null;
            /** @description All thresholds in force during the clip, in order: the initial one, then the changes. */
            threshold_changes: components["schemas"]["ThresholdChange"][];
            /** @description Latency from reception until the answer is handed to Zenoh. */
            total_latency_ms: components["schemas"]["Percentiles"];
            travel?: components["schemas"]["ClipTravel"] | null;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
        };
        /** @description The way of a clip, if positions are known. */
        ClipTravel: {
            /**
             * @description The box around all positions: west, south, east, north, degrees (RFC 7946). West is greater than east if it
             *     crosses the antimeridian.
             */
            box: number[];
            /**
             * Format: double
             * @description Distance from the first to the last position of the clip along its way, metres. Where no position is known for a
             *     while, it is the straight line.
             */
            distance_m: number;
            /**
             * Format: double
             * @description The highest speed that a position had, metres per second; absent if none had one.
             */
            fastest_m_s?: number | null;
            /** @description The way, simplified to at most 60 points: longitude and latitude of each, degrees, to about a metre. */
            track: number[][];
        };
        /** @description Recent clip reports, newest first. */
        Clips: {
            /** @description The reports, as published on Zenoh. */
            clips: components["schemas"]["ClipReport"][];
            /**
             * Format: uuid
             * @description The `before` of the next page; absent if there are no earlier clips in memory.
             */
            next?: string | null;
        };
        /** @description The counters of a camera, sent once per second. */
        CountersMessage: {
            audit?: components["schemas"]["AuditFigures"] | null;
            /** @description Frames that called the detector since the node started, by cause, including degraded ones. */
            calls?: {
                [key: string]: number;
            };
            /** @description Name of the camera. */
            camera: string;
            /**
             * Format: int64
             * @description Frames answered by prediction because the detector was not available: state P, not counted as skipped.
             */
            degraded_frames: number;
            /** @description Frames not processed, by kind. */
            dropped: components["schemas"]["DroppedFrames"];
            /**
             * Format: int64
             * @description Frames processed since the node started.
             */
            frames: number;
            /** @description Quality of the watts. */
            power_quality: components["schemas"]["EnergyQuality"];
            /**
             * Format: double
             * @description Share of frames that skipped the detector since the node started: state E or P and not degraded.
             */
            skip_rate: number;
            /** @description Frame states since the node started. */
            states: components["schemas"]["FrameStates"];
            /**
             * Format: int64
             * @description Time of these counts, nanoseconds since the Unix epoch.
             */
            t_ns: number;
            target?: components["schemas"]["TargetReport"] | null;
            threshold?: components["schemas"]["Threshold"] | null;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
            /** @description Current power by domain, watts; empty without a source. */
            watts: components["schemas"]["DomainWatts"][];
        };
        /** @description The answer with a node's desired setting. */
        Desired: {
            /**
             * Format: int32
             * @description Time between two heartbeats of the node, seconds, which is longer in a large fleet; 30 if it is absent.
             */
            heartbeat_s?: number | null;
            /**
             * Format: int64
             * @description Revision of the desired setting; a lower one never replaces a higher one. 0 if there has never been one.
             */
            revision: number;
            /** @description True if the hub missed a status and the node must send the full one. */
            send_full_status?: boolean;
            setting?: components["schemas"]["DesiredSetting"] | null;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
            /**
             * Format: int32
             * @description Remaining time for which the node is watched, seconds: until then it sends counters once per second. Absent if
             *     it is not watched.
             */
            watched_for_s?: number | null;
        };
        /** @description The desired setting of a node: a threshold or a target. A node has only one, so each kind replaces the other. */
        DesiredSetting: {
            /** @description A threshold: `{"threshold": {"name": "u", "value": 3e-4}}`. It switches a target off. */
            threshold: components["schemas"]["Threshold"];
        } | {
            target: components["schemas"]["Target"] | null;
        };
        /** @description The state and boxes of one frame. */
        DetectionsMessage: {
            /** @description The boxes in view. */
            boxes: components["schemas"]["BoxMessage"][];
            cause?: components["schemas"]["CallCause"] | null;
            /** @description Clip that the frame belongs to. */
            clip: string;
            /** @description True if the detector was needed but not available; the boxes are predictions. */
            degraded?: boolean;
            /**
             * Format: int32
             * @description Height of the picture, pixels.
             */
            height: number;
            /** @description Duration of each step. */
            latency_ms: components["schemas"]["Latency"];
            passed?: components["schemas"]["PassCause"] | null;
            /** @description True if the boxes are immediate predictions. Final state and boxes follow on the camera's `late` key. */
            pending?: boolean;
            /**
             * Format: int64
             * @description Sequence number of the frame.
             */
            seq: number;
            /** @description Frame state; `P` while the frame is pending. */
            state: components["schemas"]["FrameState"];
            /**
             * Format: int64
             * @description Capture time, nanoseconds since the Unix epoch.
             */
            t_ns: number;
            /**
             * Format: double
             * @description Largest uncertainty τ before the decision; absent without objects.
             */
            tau_max?: number | null;
            threshold?: components["schemas"]["Threshold"] | null;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
            /**
             * Format: int32
             * @description Width of the picture, pixels.
             */
            width: number;
        };
        /** @description TensorRT builds its engine. */
        DetectorEngineBuild: {
            /**
             * Format: double
             * @description Seconds since it began.
             */
            elapsed_s: number;
            /**
             * Format: double
             * @description Seconds that the last build took on this machine, of this model or of another; absent before the first.
             */
            last_build_s?: number | null;
        };
        /** @description The state of the detector. */
        DetectorEvent: {
            /** @description Execution provider that runs it; absent while it starts. */
            provider?: string | null;
            /** @description The reason, if degraded. */
            reason?: string | null;
            /** @description `starting`, `ready` or `degraded`. */
            status: string;
        };
        /** @description The input that pictures of one shape run at. */
        DetectorInput: {
            /**
             * @description `fixed`: the model has one size. Of a model with open height and width: `comparing` the smallest input that holds the
             *     picture with the largest, `smallest` once both find the same, `largest` if they do not.
             */
            choice: string;
            /**
             * @description The input, columns x rows.
             * @example 416x256
             */
            input: string;
            /**
             * Format: double
             * @description Share of the input that the picture leaves empty, 0 to 1.
             */
            padding: number;
            /**
             * @description Size of the first picture of this shape, columns x rows.
             * @example 1920x1080
             */
            picture: string;
            /** @description The same in words, with the reason and what to do. */
            words: string;
        };
        /** @description What the comparison of a provider with the CPU showed. */
        DetectorPrecision: {
            /** @description True if all boxes agree within 2 pixels of the input and 0.02 of confidence; absent if they could not be compared. */
            agrees?: boolean | null;
            /** @description The outcome in words, with what to do. */
            words: string;
        };
        /** @description How the detector's model is read, and which of its classes are reported. */
        DetectorReading: {
            /**
             * Format: int64
             * @description Rows of the model's output that were impossible since the start: a number that is not finite, or a box without an
             *     area or much larger than the input.
             */
            boxes_impossible: number;
            /**
             * Format: int64
             * @description Boxes of these classes since the start.
             */
            boxes_left_out: number;
            /** @description Names of the classes that are reported, by class number. */
            classes: string[];
            engine_build?: components["schemas"]["DetectorEngineBuild"] | null;
            /** @description Head and input, in words. */
            head: string;
            /** @description The inputs that pictures run at, one for each shape of picture that has come. */
            inputs: components["schemas"]["DetectorInput"][];
            /** @description Names of the model's classes that are not reported (`detector.report_classes`). */
            left_out: string[];
            precision?: components["schemas"]["DetectorPrecision"] | null;
        };
        /** @description Energy of one domain of the board. */
        DomainEnergy: {
            /** @description `total`, `gpu`, `cpu`, `io_mem`. */
            domain: string;
            /**
             * Format: double
             * @description Joules over the time covered by samples.
             */
            joules: number;
            /**
             * Format: double
             * @description Mean power over the time covered by samples, watts.
             */
            mean_watts: number;
            /**
             * Format: double
             * @description Highest sample, watts; if the source counts energy, the highest mean between two samples. Absent without a
             *     sample inside the clip.
             */
            peak_watts?: number | null;
        };
        /** @description The current power of one domain. */
        DomainWatts: {
            /** @description `total`, `gpu`, `cpu`, `io_mem`. */
            domain: string;
            /**
             * Format: double
             * @description Power of the newest sample, watts.
             */
            watts: number;
        };
        /** @description Frames that were not processed, by kind. */
        DroppedFrames: {
            /**
             * Format: int64
             * @description Arrived again with the same sequence number.
             * @default 0
             */
            duplicate: number;
            /**
             * Format: int64
             * @description Arrived after a later frame; first counted as lost.
             * @default 0
             */
            late: number;
            /**
             * Format: int64
             * @description Never arrived: missing sequence numbers.
             * @default 0
             */
            lost: number;
            /**
             * Format: int64
             * @description Replaced in the ring by a newer frame before their turn.
             * @default 0
             */
            overrun: number;
            /**
             * Format: int64
             * @description The size of payload, picture or decompressed data exceeds the limit.
             * @default 0
             */
            oversized: number;
            /**
             * Format: int64
             * @description Arrived or waited while the camera's loop was not running, after a failure or during shutdown.
             * @default 0
             */
            stopped: number;
            /**
             * Format: int64
             * @description From a stream other than the camera's current one: another publisher, or a distant sequence number.
             * @default 0
             */
            stray: number;
            /**
             * Format: int64
             * @description The picture cannot be decoded or contradicts its header.
             * @default 0
             */
            undecodable: number;
            /**
             * Format: int64
             * @description The payload encoding is unknown, or the attachment is unreadable.
             * @default 0
             */
            unknown_format: number;
        };
        /**
         * @description The quality of an energy figure, from the most to the least reliable.
         * @enum {string}
         */
        EnergyQuality: "measured" | "partial" | "estimated" | "unavailable";
        /** @description Energy of the whole node over a time. */
        EnergyUsed: {
            /**
             * Format: double
             * @description That time, seconds.
             */
            covered_s: number;
            /**
             * Format: double
             * @description Joules, over the time that samples cover.
             */
            joules: number;
            /** @description The quality of the joules: partial if the meter had gaps. */
            quality: components["schemas"]["EnergyQuality"];
            /**
             * Format: double
             * @description Estimated energy that the avoided calls would have cost, joules: the time they would have run, at most the idle time
             *     of the one detector, times the watts that a running detector adds on this machine. Null while those are not known.
             */
            saved_joules_estimated?: number | null;
        };
        /** @description The fault of a part. */
        Fault: {
            /** @description `not_ready` if the service cannot do its work, `degraded` if it works in spite of the fault. */
            effect: components["schemas"]["HealthState"];
            /** @description The reason, human-readable. One that differs only in its numbers is no news in the log. */
            reason: string;
        };
        /** @description What was forwarded to one place since the start. */
        ForwardedCounts: {
            /**
             * Format: int64
             * @description Messages that were given up: too many waited, or the place refused them for good.
             */
            dropped: number;
            /**
             * Format: int64
             * @description Attempts that failed; each is repeated later.
             */
            failed: number;
            /**
             * Format: int64
             * @description Messages that the place has acknowledged.
             */
            sent: number;
            /** @description The place: `mqtts://broker.example:8883`, `https://house.example/…`. */
            to: string;
        };
        /**
         * @description The node's answer to a frame received as a query, sent when the frame's turn comes: the sender of a camera with
         *     `delivery = "every"` then sends its next frame. If a query ends without an answer, the frame was not accepted.
         */
        FrameAnswer: {
            /** @description The reason why the frame will not be processed; absent if it will be. */
            refused?: string | null;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
        };
        /** @description Metadata that a camera may add to a frame, in the attachment of its sample. */
        FrameAttachment: {
            /** @description Clip that the frame belongs to. Without it, clips are fixed time windows. */
            clip?: string | null;
            /**
             * Format: int32
             * @description Height of a raw picture, pixels.
             */
            height?: number | null;
            position?: components["schemas"]["Position"] | null;
            /**
             * Format: int64
             * @description Sequence number, incremented per frame. Without it, frames are numbered by arrival.
             */
            seq?: number | null;
            /**
             * Format: int64
             * @description Stream that `seq` belongs to: a sender that restarts uses another number, such as its start time in nanoseconds,
             *     and so loses no frame.
             */
            stream?: number | null;
            /**
             * Format: int64
             * @description Capture time, nanoseconds since the Unix epoch. Without it, the sample's timestamp is used.
             */
            t_ns?: number | null;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
            /**
             * Format: int32
             * @description Width of a raw picture, pixels.
             */
            width?: number | null;
        };
        /** @description Counts of frames since the node started. */
        FrameCounts: {
            audit?: components["schemas"]["AuditFigures"] | null;
            /** @description Frames for which the detector was called, by cause, including degraded ones. */
            calls: {
                [key: string]: number;
            };
            /**
             * Format: int64
             * @description Frames answered from prediction because the detector was not available.
             */
            degraded_frames: number;
            /**
             * Format: int64
             * @description Frames processed.
             */
            frames: number;
            /**
             * Format: double
             * @description Share of frames that skipped the detector: state E or P and not degraded.
             */
            skip_rate: number;
            /** @description Number of frames in each state; they add up to `frames`. */
            states: components["schemas"]["FrameStates"];
        };
        /** @description A frame was answered: its detections message and its camera. */
        FrameEvent: components["schemas"]["DetectionsMessage"] & {
            /** @description Camera. */
            camera: string;
        };
        /**
         * @description The state of a frame; every frame has exactly one (paper, table of frame states).
         * @enum {string}
         */
        FrameState: "E" | "P" | "E+I" | "I" | "AI";
        /** @description Number of frames in each state. */
        FrameStates: {
            /**
             * Format: int64
             * @description The detector ran, and at least one object was rescued.
             */
            AI: number;
            /**
             * Format: int64
             * @description The screen reported "empty"; the detector was skipped.
             */
            E: number;
            /**
             * Format: int64
             * @description The screen reported "not empty"; the detector ran.
             */
            "E+I": number;
            /**
             * Format: int64
             * @description The detector ran.
             */
            I: number;
            /**
             * Format: int64
             * @description The boxes are predicted; the detector was skipped.
             */
            P: number;
        };
        /** @description The process answers. */
        Health: {
            /** @description The node. */
            node: string;
            /** @description Always `ok`. */
            status: string;
            /**
             * Format: double
             * @description Seconds since it started.
             */
            uptime_s: number;
            /** @description The program's version. */
            version: string;
        };
        /**
         * @description The health of a node.
         * @enum {string}
         */
        HealthState: "ready" | "degraded" | "not_ready";
        /** @description The health of a node with the reasons. */
        HealthStatus: {
            /** @description Problems by part; empty when ready. */
            reasons: {
                [key: string]: string;
            };
            /** @description Health of the node. */
            state: components["schemas"]["HealthState"];
        };
        /** @description Service, version and list of routes. */
        Index: {
            /** @description Names of the cameras. */
            cameras: string[];
            /** @description The node's name. */
            node: string;
            /** @description The path of the full description. */
            openapi: string;
            /** @description The policy that decides the frames. */
            policy: string;
            /** @description All routes. */
            routes: components["schemas"]["Route"][];
            /** @description The program's version. */
            version: string;
        };
        /** @description Duration of each step of one frame, milliseconds. A step that did not happen is absent. */
        Latency: {
            /**
             * Format: double
             * @description Picture decoding.
             */
            decode?: number | null;
            /**
             * Format: double
             * @description The detector: queue, letterbox, model and head.
             */
            detector?: number | null;
            /**
             * Format: double
             * @description The policy itself.
             */
            policy: number;
            /**
             * Format: double
             * @description The empty-scene screen, including its preprocessing.
             */
            screen?: number | null;
            /**
             * Format: double
             * @description From reception to the answer, excluding JSON serialization, publication and time in Zenoh.
             */
            total: number;
            /**
             * Format: double
             * @description Wait in the ring for the camera's loop.
             */
            waiting: number;
        };
        /** @description Lines of the log. */
        Log: {
            /** @description The oldest first. */
            lines: components["schemas"]["LogLine"][];
        };
        /** @description One line of the log. */
        LogLine: {
            /**
             * Format: int64
             * @description Its time, milliseconds since the Unix epoch.
             */
            at_ms: number;
            /** @description `ERROR`, `WARN`, `INFO`, `DEBUG` or `TRACE`. */
            level: string;
            /**
             * Format: int64
             * @description Its number, from 1 at the start.
             */
            number: number;
            /** @description Part of the program that wrote it. */
            target: string;
            /** @description Spans, message and fields. */
            text: string;
        };
        /** @description A request for a recording: `{"reason": "braking"}`. */
        NewRecording: {
            /** @description The camera; all cameras by default. */
            camera?: string | null;
            /** @description Why, in a few words, which the recording keeps. */
            reason?: string | null;
        };
        /** @description A new threshold: `{"u": 3e-4}`, or `{"lambda": 0.3}` under expected-loss. */
        NewThreshold: {
            /**
             * Format: int32
             * @description Version of the message; may be left out.
             */
            v?: number | null;
        };
        /** @description Pictures of a camera without news. */
        NoNews: {
            /** @description Why. */
            cause: components["schemas"]["PassCause"];
            /**
             * Format: double
             * @description For how long nothing has changed, seconds.
             */
            for_s: number;
        };
        /** @description A node: its readiness, run time, energy and savings. */
        NodeOverview: components["schemas"]["Readiness"] & {
            /** @description The certificates of its sessions, with their ends. */
            certificates: components["schemas"]["CertificateStatus"][];
            detector?: components["schemas"]["DetectorReading"] | null;
            /** @description What was forwarded to hooks and an MQTT broker. */
            forwarded: components["schemas"]["ForwardedCounts"][];
            /** @description The first Zenoh endpoint at which the node, or its router, takes frames: of `zenoh.listen`, or of `zenoh.connect`. */
            frames_at?: string | null;
            /** @description The address of the hub's page: the label `hub`; absent without it. */
            hub?: string | null;
            /** @description Reports that wait for a hub. */
            outbox: components["schemas"]["OutboxStatus"];
            /** @description Where its positions come from; never the position itself. */
            position: components["schemas"]["PositionStatus"];
            /** @description The source of its figures of power: `rapl`, `estimate`, …; `none` without one. */
            power_source: string;
            /** @description Savings since the start. */
            since_start: components["schemas"]["Savings"];
            since_switch?: components["schemas"]["Savings"] | null;
            /** @description Savings of today: since midnight UTC, or since the start if that is later. */
            today: components["schemas"]["Savings"];
            /**
             * Format: double
             * @description Seconds since it started.
             */
            uptime_s: number;
            /** @description The program's version. */
            version: string;
        };
        /** @description Counts of all frames since the node started. */
        NodeStates: components["schemas"]["FrameCounts"] & {
            /** @description The counts of each camera. */
            cameras: components["schemas"]["CameraStates"][];
            /** @description Node. */
            node: string;
            /**
             * Format: double
             * @description Seconds since it started.
             */
            uptime_s: number;
        };
        /** @description The full status that a hub shows of a node between reports. */
        NodeStatus: {
            /** @description The node's cameras. */
            cameras: components["schemas"]["CameraStatus"][];
            /** @description The certificates with which the node identifies itself, and those it trusts. */
            certificates?: components["schemas"]["CertificateStatus"][];
            /** @description Health with its reasons. */
            health: components["schemas"]["HealthStatus"];
            /** @description Labels from the configuration, for selecting nodes: `region = "north"`. */
            labels?: {
                [key: string]: string;
            };
            /** @description File name of the detector model. */
            model: string;
            /** @description The reports that wait, and those that were lost. */
            outbox: components["schemas"]["OutboxStatus"];
            /** @description Name of the policy, the same for all cameras. */
            policy: string;
            /** @description Quality of the power figures. */
            power_quality: components["schemas"]["EnergyQuality"];
            /** @description Source of the power figures: `rapl`, `estimate`, … */
            power_source: string;
            /** @description Execution provider that actually runs the model; absent until the model is loaded. */
            provider?: string | null;
            refused?: components["schemas"]["RefusedRevision"] | null;
            target?: components["schemas"]["NodeTarget"] | null;
            /** @description Human-readable reason why a target that the node had since its start was switched off. */
            target_off?: string | null;
            /** @description Version of the program. */
            version: string;
        };
        /** @description The target in a node's status, without the figures that change constantly. */
        NodeTarget: {
            /**
             * Format: double
             * @description The measured value when the status was created.
             */
            actual?: number | null;
            /** @description Origin of the target. */
            source: components["schemas"]["SettingSource"];
            status?: components["schemas"]["TargetStatus"] | null;
            /** @description The target. */
            target: components["schemas"]["Target"];
        };
        /** @description [`Readiness`] as a problem document. */
        NotReady: components["schemas"]["Problem"] & components["schemas"]["Readiness"];
        /**
         * Format: int64
         * @description Number of an object within a stream, from 0, never reused.
         */
        ObjectId: number;
        /** @description The outbox of a [`NodeStatus`]. */
        OutboxStatus: {
            /** @description True if reports survive a power loss; false without a state directory or if its disk fails. */
            durable: boolean;
            /**
             * Format: int64
             * @description Reports lost because the outbox was full or its disk failed.
             */
            lost: number;
            /**
             * Format: int64
             * @description Reports that a hub refused permanently or that could not be read.
             */
            undeliverable?: number;
            /**
             * Format: int64
             * @description Reports waiting for delivery.
             */
            waiting: number;
        };
        /** @description A fault of one of the service's parts. */
        PartFault: components["schemas"]["Fault"] & {
            /** @description The part: `detector`, `zenoh`, … */
            part: string;
            /**
             * Format: double
             * @description Seconds for which the part has been faulty, for any reason.
             */
            since_s: number;
            /** @description The name of a camera or a task, if the part has several; absent for the part itself. */
            subject?: string | null;
        };
        /**
         * @description The reason why a frame was passed over by a pause.
         * @enum {string}
         */
        PassCause: "empty_road" | "unchanged" | "dark";
        /** @description The last frames in columns: the n-th entry of each belongs to the n-th frame, the oldest first. */
        PastFrames: {
            /** @description Milliseconds between its answer and `now_ms`. */
            age_ms: number[];
            /** @description Boxes reported. */
            boxes: number[];
            /** @description Cause of the detector call; null if there was none. */
            cause: (components["schemas"]["CallCause"] | null)[];
            /** @description True if the detector was needed but not available. */
            degraded: boolean[];
            /** @description Milliseconds of the detector; null if it did not run. */
            detector_ms: (number | null)[];
            /** @description Sequence number. */
            seq: number[];
            /** @description Frame state. */
            state: components["schemas"]["FrameState"][];
            /** @description Largest uncertainty before the decision; null without objects. */
            tau_max: (number | null)[];
            /** @description Threshold in force; null if the policy has none. */
            threshold: (number | null)[];
            /** @description Milliseconds from reception to publication. */
            total_ms: number[];
        };
        /** @description The pause on an empty road. */
        Pause: {
            /**
             * Format: double
             * @description Seconds without a detection after which the road is empty.
             */
            after_s: number;
            /** @description False if the policy takes no pause on an empty road: it does not call the detector whenever nothing is tracked. */
            applies: boolean;
            /** @description What it means for each camera. */
            cameras: components["schemas"]["CameraPause"][];
            /**
             * Format: double
             * @description Seconds from one look at an empty road to the next; 0 looks at every frame.
             */
            pause_s: number;
            /**
             * Format: double
             * @description Seconds from one look at a picture without news to the next; 0 compares no pictures. Works under every policy that
             *     looks at no pictures itself.
             */
            still_s: number;
            /** @description True if what was set at run time survives a restart. */
            survives_restart: boolean;
        };
        /** @description Pauses, of all cameras: `{"pause_s": 0.2}`. What is left out stays as it is. */
        Pauses: {
            /**
             * Format: double
             * @description Seconds without a detection after which the road is empty.
             */
            after_s?: number | null;
            /**
             * Format: double
             * @description Seconds from one look at an empty road to the next; 0 looks at every frame.
             */
            pause_s?: number | null;
            /**
             * Format: double
             * @description Seconds from one look at a picture without news to the next; 0 compares no pictures.
             */
            still_s?: number | null;
        };
        /** @description Mean and percentiles of a set of durations, milliseconds. */
        Percentiles: {
            /**
             * Format: int64
             * @description Number of durations.
             */
            count: number;
            /**
             * Format: double
             * @description Arithmetic mean.
             */
            mean: number;
            /**
             * Format: double
             * @description Median.
             */
            p50: number;
            /**
             * Format: double
             * @description 95th percentile.
             */
            p95: number;
            /**
             * Format: double
             * @description 99th percentile.
             */
            p99: number;
        };
        /** @description A policy by its name, of all cameras: `{"name": "expected-loss"}`. */
        PolicyChoice: {
            /** @description Its name, as in `policy.name` of the configuration. */
            name: string;
        };
        /** @description The policy in force. */
        PolicyInForce: {
            /** @description The policy of the configuration, `policy.name`. */
            configured: string;
            /** @description Its name. */
            name: string;
            /** @description What does nothing under it although it is set, in words. */
            notes: string[];
            /** @description The names of all policies. */
            policies: string[];
            /** @description True if a switch survives a restart. */
            survives_restart: boolean;
            /** @description The name of its threshold; absent if it has none. */
            threshold?: string | null;
        };
        /** @description The policy in a put, in a query's payload and in the answer to a query: `{"policy": {"name": "expected-loss"}}`. */
        PolicyMessage: {
            /** @description The policy. */
            policy: components["schemas"]["PolicyChoice"];
            /**
             * Format: int32
             * @description Version of the message; optional on input.
             */
            v?: number;
        };
        /** @description A place on the Earth (WGS 84), and the speed there. */
        Position: {
            /**
             * Format: double
             * @description Degrees north of the equator, -90 to 90.
             */
            latitude: number;
            /**
             * Format: double
             * @description Degrees east of Greenwich, -180 to 180.
             */
            longitude: number;
            /**
             * Format: double
             * @description Speed over ground, metres per second.
             */
            speed_m_s?: number | null;
        };
        /** @description Where positions come from, and how many came; never the position itself. */
        PositionStatus: {
            /**
             * Format: int64
             * @description Positions in attachments that were ignored because `position.source` is off.
             */
            ignored: number;
            /** @description True if frames now have a position from the receiver. */
            is_known: boolean;
            /** @description The reason why the last one could not be used. */
            last_refused?: string | null;
            /**
             * Format: int64
             * @description Positions in attachments of frames that were used.
             */
            of_frames: number;
            /**
             * Format: int64
             * @description Positions of the receiver since the start.
             */
            received: number;
            /**
             * Format: int64
             * @description Positions that could not be used, or lines of a receiver that could not be read.
             */
            refused: number;
            /** @description `position.source` of the configuration. */
            source: string;
            /** @description What the receiver does; empty without one. */
            words: string;
        };
        /** @description Power over the last hour. */
        PowerHistory: {
            /**
             * Format: int64
             * @description Length of a piece, seconds.
             */
            slot_s: number;
            /** @description The finished pieces, the oldest first; pieces without a figure are left out. */
            slots: components["schemas"]["PowerPiece"][];
        };
        /** @description Power of a piece of the last hour. */
        PowerPiece: {
            /**
             * Format: int64
             * @description Its start, milliseconds since the Unix epoch.
             */
            at_ms: number;
            /** @description Its quality: the worst during the piece. */
            quality: components["schemas"]["EnergyQuality"];
            /** @description Mean power over the time that samples cover, watts, by domain. */
            watts: {
                [key: string]: number;
            };
        };
        /** @description An error of a request, and how to correct it. */
        Problem: {
            /** @description The allowed methods, names or media types. */
            allowed?: string[];
            /** @description The error of this request. */
            detail: string;
            /**
             * Format: int32
             * @description The HTTP status.
             */
            status: number;
            threshold_spec?: components["schemas"]["ThresholdSpec"] | null;
            /** @description The text of the status. */
            title: string;
            /** @description Always `about:blank`: the title is the text of the status. */
            type: string;
        };
        /** @description The readiness of the node, and what processes its frames. */
        Readiness: {
            /** @description File name of the detector's model. */
            model: string;
            /** @description The node. */
            node: string;
            /** @description The policy that decides frames. */
            policy: string;
            /** @description Execution provider that runs the detector; absent while it starts. */
            provider?: string | null;
            /** @description True if frames are answered, perhaps with a part missing. */
            ready: boolean;
            /** @description The faults; empty when every part works. */
            reasons: components["schemas"]["PartFault"][];
            /** @description Configured execution providers, in order. */
            requested_providers: string[];
            /** @description True if every part works. */
            state: components["schemas"]["HealthState"];
        };
        /** @description What is recorded, and what is not. */
        RecordingStatus: {
            /**
             * Format: double
             * @description See `before_s`.
             */
            after_s: number;
            /**
             * Format: int64
             * @description Frames since the start on which the audit found a difference, and that are in a recording.
             */
            audited_frames: number;
            /**
             * Format: double
             * @description Seconds that are kept before and after an event.
             */
            before_s: number;
            /**
             * Format: int64
             * @description Their bytes.
             */
            bytes: number;
            /**
             * Format: int64
             * @description Frames since the start that are missing in a recording because the disk or the processor is too slow.
             */
            dropped_frames: number;
            /**
             * Format: int64
             * @description Events since the start.
             */
            events: number;
            /**
             * Format: int64
             * @description Frames since the start that are missing because the disk or the picture is at fault.
             */
            failed_frames: number;
            /** @description Why nothing can be written. */
            fault?: string | null;
            /**
             * Format: int64
             * @description Recordings in the folder.
             */
            files: number;
            /** @description The folder; absent if nothing is recorded. */
            folder?: string | null;
            /**
             * Format: double
             * @description Days after which a recording is deleted.
             */
            keep_days: number;
            /**
             * Format: int64
             * @description The most bytes: the oldest recordings are deleted first.
             */
            max_bytes: number;
            /** @description The cameras of which there is nothing to record, and what to do. */
            missing?: string | null;
            /** @description The cameras that are being recorded now. */
            recording: string[];
            /** @description Why the last such event has fewer seconds before it than `before_s`. */
            shortened?: string | null;
            /** @description What begins a recording besides a request: `always`, `audit`. */
            when: string[];
            /**
             * Format: int64
             * @description Frames since the start that are in a recording.
             */
            written_frames: number;
        };
        /** @description A report that a hub will never store. */
        RefusedReport: {
            /**
             * Format: uuid
             * @description The report's id.
             */
            id: string;
            /** @description Why it will never be stored, human-readable. */
            reason: string;
        };
        /** @description A desired value that a node refused. */
        RefusedRevision: {
            /** @description Human-readable reason: the policy has another threshold, or the value is out of range. */
            reason: string;
            /**
             * Format: int64
             * @description Revision of the value, greater than the one in force.
             */
            revision: number;
        };
        /** @description What a node knows of a report's age without its wall clock. */
        ReportAge: {
            /** @description True if this node made it and never sent it before. */
            first?: boolean;
            /**
             * Format: int64
             * @description Seconds since it was made, by a clock that nobody sets; absent if the machine was started since then.
             */
            made_s?: number | null;
        };
        /** @description The acknowledgement of a batch, sent after the hub's commit: all its reports are stored, except the refused ones. */
        ReportAnswer: {
            desired?: components["schemas"]["Desired"] | null;
            /**
             * @description Ranges, inclusive, of the node's report counts ([`ClipReport::count`]) that never arrived: the node resends
             *     those that it still has.
             */
            missing?: [
                number,
                number
            ][];
            /** @description Reports that will never be stored: they are too old or invalid. */
            refused?: components["schemas"]["RefusedReport"][];
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
        };
        /**
         * @description Reports of one node, oldest first. On the wire: one byte with the dictionary's number, then JSON compressed with
         *     Zstandard and that dictionary (`crates/wire/src/report/dictionary-1.json`).
         */
        ReportBatch: {
            /**
             * @description What the node knows of the age of each report, in the same order: its wall clock may have been wrong, and set
             *     since. Empty from nodes that do not say it.
             */
            ages?: components["schemas"]["ReportAge"][];
            /** @description Name of the node; the same in every report. */
            node: string;
            /** @description The reports, at most [`MOST_REPORTS`]. */
            reports: components["schemas"]["ClipReport"][];
            /**
             * Format: int64
             * @description The node's clock when it sent the batch, milliseconds since the Unix epoch, from which a hub checks that the
             *     times in the reports are plausible.
             */
            t_ms: number;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
        };
        /** @description The revision of a desired setting: in a notice the one that the node may pull, in a pull the one that it has. */
        RevisionMessage: {
            /**
             * Format: int64
             * @description The revision; 0 for none.
             */
            revision: number;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
        };
        /** @description A route. */
        Route: {
            /** @description `GET`, `PUT`, `POST` or `DELETE`. */
            method: string;
            /** @description Its path; `{camera}` is replaced by a camera's name. */
            path: string;
            /** @description Its summary. */
            summary: string;
        };
        /** @description Savings over a time. */
        Savings: {
            /**
             * Format: int64
             * @description Avoided calls of the detector: frames answered without it, except degraded ones.
             */
            avoided_calls: number;
            /**
             * Format: int64
             * @description Frames answered from prediction because the detector was not available.
             */
            degraded_frames: number;
            energy?: components["schemas"]["EnergyUsed"] | null;
            /**
             * Format: int64
             * @description Frames processed.
             */
            frames: number;
            /**
             * Format: int64
             * @description The beginning of the time, milliseconds since the Unix epoch: the node's start, or midnight UTC if that is later.
             */
            since_ms: number;
        };
        /** @description The pauses in a put, in a query's payload and in the answer to a query: `{"screen": {"pause_s": 0.2}}`. */
        ScreenMessage: {
            /** @description The pauses. */
            screen: components["schemas"]["Pauses"];
            /**
             * Format: int32
             * @description Version of the message; optional on input.
             */
            v?: number;
        };
        /**
         * @description The origin of a threshold or a target.
         * @enum {string}
         */
        SettingSource: "configuration" | "local" | "hub";
        /** @description The boxes of one frame for recordings, interpolated between two detector calls if the second came in time. */
        SettledMessage: {
            /** @description The boxes in view. */
            boxes: components["schemas"]["BoxMessage"][];
            /** @description Clip that the frame belongs to. */
            clip: string;
            /**
             * Format: int32
             * @description Height of the picture, pixels.
             */
            height: number;
            /**
             * Format: int64
             * @description Sequence number of the frame.
             */
            seq: number;
            /** @description False if the boxes are those of the original answer because no later detector call came in time. */
            settled: boolean;
            /** @description The frame's final state. */
            state: components["schemas"]["FrameState"];
            /**
             * Format: int64
             * @description Capture time, nanoseconds since the Unix epoch.
             */
            t_ns: number;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
            /**
             * Format: int32
             * @description Width of the picture, pixels.
             */
            width: number;
        };
        /** @description A class appeared in a camera's picture, or left it: the body of a hook's POST, and of the MQTT topic `…/event`. */
        Sighting: {
            /** @description Name of the camera. */
            camera: string;
            /** @description Name of the class. */
            class: string;
            /**
             * Format: float
             * @description The highest confidence among them; absent if it left.
             */
            confidence?: number | null;
            /**
             * Format: int32
             * @description Boxes of the class in the frame that decided it.
             */
            count: number;
            /** @description What became of it. */
            event: components["schemas"]["SightingEvent"];
            /** @description Name of the node. */
            node: string;
            /**
             * Format: double
             * @description If it left: seconds from its first to its last frame.
             */
            seconds?: number | null;
            /**
             * Format: int64
             * @description Sequence number of the frame that decided it.
             */
            seq: number;
            /**
             * Format: int64
             * @description Time of the first frame with the class, if it appeared, or of the last, if it left: `t_ns` is later by the time
             *     for which it had to be there, or away.
             */
            since_ns: number;
            /**
             * Format: int64
             * @description The frame's time, nanoseconds since the Unix epoch, as in its detections message.
             */
            t_ns: number;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v?: number;
        };
        /**
         * @description What became of a class.
         * @enum {string}
         */
        SightingEvent: "appeared" | "left";
        /** @description Estimates of the frames that other thresholds would have skipped. */
        SkipEstimate: {
            /**
             * Format: double
             * @description Time they took, seconds.
             */
            duration_s: number;
            /** @description The number of frames. */
            frames: number;
            /**
             * Format: double
             * @description Their share of the frames.
             */
            skip_rate: number;
            /** @description Frames that were actually answered without the detector. */
            skipped: number;
            /** @description The estimate for each value, in the requested order. */
            values: components["schemas"]["ValueEstimate"][];
        };
        /** @description Estimates of the frames that other thresholds would have skipped over the last minutes. */
        SkipEstimates: components["schemas"]["SkipEstimate"] & {
            /** @description Camera. */
            camera: string;
            /**
             * @description Always true: under another value other frames would have been matched, so objects would have evolved differently.
             *     Recorded uncertainties are scaled by how they grew with the time since a call.
             */
            estimated: boolean;
            /** @description The threshold in force. */
            threshold: components["schemas"]["Threshold"];
        };
        /**
         * @description A heartbeat, with the full status if it changed or was requested. If only the number of waiting reports changed, the
         *     node sends a [`Heartbeat`] instead.
         */
        StatusMessage: {
            full?: components["schemas"]["NodeStatus"] | null;
            /** @description Health of the node. */
            health: components["schemas"]["HealthState"];
            /**
             * Format: int64
             * @description Revision of the desired value in force; 0 for none.
             */
            revision: number;
            /**
             * Format: int32
             * @description A random number for this run of the process: it distinguishes two runs, and two nodes with the same name.
             */
            run: number;
            /**
             * Format: int64
             * @description Number of this message within the run, from 0; after a gap the hub requests the full status.
             */
            seq: number;
            /**
             * Format: int64
             * @description Start time of the process, nanoseconds since the Unix epoch.
             */
            started_ns: number;
            /**
             * Format: int64
             * @description The node's clock, nanoseconds since the Unix epoch.
             */
            t_ns: number;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
            /**
             * Format: int64
             * @description Reports waiting in the outbox.
             */
            waiting: number;
        };
        /** @description The target to hold. In JSON, one field: `{"skip_rate": 0.5}`. */
        Target: {
            /**
             * Format: double
             * @description Recall against the detector: the lower end of its interval is held at this value.
             */
            recall: number;
        } | {
            /**
             * Format: double
             * @description Share of frames that skip the detector.
             */
            skip_rate: number;
        } | {
            /**
             * Format: double
             * @description Mean power of the node, watts.
             */
            watts: number;
        };
        /**
         * @description A target in a put, in a query's payload and in a request: `{"target": {"skip_rate": 0.5}}`, or `{"target": null}`
         *     for none.
         */
        TargetMessage: {
            target?: components["schemas"]["Target"] | null;
            /**
             * Format: int32
             * @description Version of the message; optional on input.
             */
            v?: number;
        };
        /** @description The target of a node and its state. */
        TargetReport: {
            /** @description Human-readable reason why there is no target any more. */
            off?: string | null;
            range?: components["schemas"]["ThresholdRange"] | null;
            /** @description Origin of the target or of its removal. */
            source: components["schemas"]["SettingSource"];
            state?: components["schemas"]["TargetState"] | null;
            target?: components["schemas"]["Target"] | null;
            threshold?: components["schemas"]["Threshold"] | null;
            /**
             * Format: int32
             * @description Version of the message.
             */
            v: number;
            /** @description The state, human-readable. */
            why?: string | null;
        };
        /** @description The state of a target. */
        TargetState: {
            /**
             * Format: double
             * @description The measured value; for recall, the lower end of its interval. Absent before the first measurement.
             */
            actual?: number | null;
            /**
             * Format: int64
             * @description For recall, the number of boxes behind the measured value.
             */
            boxes?: number | null;
            /** @description The reason for that value. */
            status: components["schemas"]["TargetStatus"];
            /**
             * Format: double
             * @description The threshold's current value.
             */
            threshold: number;
            /**
             * Format: int64
             * @description Number of times that this began.
             */
            unmet: number;
            /**
             * Format: double
             * @description Time during which the target could not be met inside the range, seconds.
             */
            unmet_s: number;
        };
        /**
         * @description The reason for the threshold's value.
         * @enum {string}
         */
        TargetStatus: "measuring" | "moving" | "held" | "more_than_kept" | "cannot_be_met" | "no_frames" | "no_power" | "no_audit";
        /**
         * @description The value of a policy's threshold with the policy's name for it: `{"name": "u", "value": 3e-4}`, or `lambda` under
         *     expected-loss. The name prevents mistaking one policy's value for another's.
         */
        Threshold: {
            /** @description The policy's name for it. */
            name: string;
            /**
             * Format: double
             * @description Its value; its range depends on the policy.
             */
            value: number;
        };
        /** @description A change of the threshold during a clip. */
        ThresholdChange: {
            /**
             * Format: int64
             * @description First frame to which it applies.
             */
            seq: number;
            /** @description The new value. */
            threshold: components["schemas"]["Threshold"];
        };
        /** @description A threshold changed; it applies from the camera's next frame. */
        ThresholdEvent: {
            /** @description Camera. */
            camera: string;
            /** @description The threshold now. */
            threshold: components["schemas"]["Threshold"];
        };
        /** @description The threshold of a camera, on its `threshold` key: in a put, in a query's payload and in the reply. */
        ThresholdMessage: {
            /** @description The threshold. */
            threshold: components["schemas"]["Threshold"];
            /**
             * Format: int32
             * @description Version of the message; optional on input.
             */
            v?: number;
        };
        /** @description The range within which a controller moves a threshold. */
        ThresholdRange: {
            /**
             * Format: double
             * @description Smallest value: the most accurate one.
             */
            least: number;
            /**
             * Format: double
             * @description Largest value that accuracy still allows.
             */
            most: number;
        };
        /** @description The threshold of a policy, which a user may change while it runs: its name, range and default. */
        ThresholdSpec: {
            /**
             * Format: double
             * @description Default value.
             */
            default: number;
            /**
             * Format: double
             * @description Largest value allowed.
             */
            maximum: number;
            /** @description The effect of changing it, in one sentence. */
            meaning: string;
            /**
             * Format: double
             * @description Smallest value allowed.
             */
            minimum: number;
            /** @description Name in configuration, messages and reports: `u`, `lambda`, … */
            name: string;
            /**
             * Format: double
             * @description Upper end of a slider: above it hardly anything more is saved, at a high price.
             */
            useful_maximum: number;
            /**
             * Format: double
             * @description Lower end of a slider: below it hardly anything is saved.
             */
            useful_minimum: number;
        };
        /** @description The thresholds of a node. */
        Thresholds: {
            /** @description The thresholds of each camera. */
            cameras: components["schemas"]["CameraThreshold"][];
            /** @description True if values set at run time survive a restart. */
            survives_restart: boolean;
        };
        /** @description The estimate for one value. */
        ValueEstimate: {
            /**
             * Format: double
             * @description Share of the frames.
             */
            skip_rate: number;
            /** @description Frames without the detector. */
            skipped: number;
            /**
             * Format: double
             * @description The value.
             */
            value: number;
        };
        /** @description The caller. */
        WhoAsks: {
            /** @description True if the caller may change settings, and not only read. */
            may_tune: boolean;
            /** @description The name of the token; `anonymous` without one. */
            name: string;
            /** @description True if the interface needs a token that the request lacks. */
            token_needed: boolean;
        };
    };
    responses: never;
    parameters: never;
    requestBodies: never;
    headers: never;
    pathItems: never;
}
export type $defs = Record<string, never>;
export type operations = Record<string, never>;
