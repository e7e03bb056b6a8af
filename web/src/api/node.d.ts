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
         * Who asks, and what that one may do
         * @description Open to all: it answers what a token is good for, and that one is needed where it is missing or not known.
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
                        "application/json": components["schemas"]["CameraDetail"];
                    };
                };
                404: {
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
         * What was found in a camera's newest frame
         * @description The message that was published on Zenoh for it.
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
                /** @description There is no such camera, or no frame has come from it yet. */
                404: {
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
                404: {
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
         *     `curl -o frame.jpg http://127.0.0.1:8080/api/v1/cameras/front/frame.jpg`
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
                        /** @description Sequence number of the frame. */
                        "albireo-frame"?: number;
                        [name: string]: unknown;
                    };
                    content: {
                        "image/jpeg": number[];
                    };
                };
                404: {
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
         * What other thresholds would have skipped over the last minutes
         * @description An estimate from the uncertainties that were recorded frame by frame, for the threshold `u`.
         *     `curl 'http://127.0.0.1:8080/api/v1/cameras/front/skip-estimate?values=1e-4,3e-4,1e-3'`
         */
        get: {
            parameters: {
                query?: {
                    /**
                     * @description Values of the threshold, separated by commas, at most 64; without it, 41 from a hundredth of the default to a hundred
                     *     times it.
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
                /** @description The policy is not turned by u, or has no record to estimate from yet. */
                409: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
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
                404: {
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
         * @description The node keeps the newest 256 in memory. `before` and `after` take the identities of reports (`id`).
         *     `curl 'http://127.0.0.1:8080/api/v1/clips?camera=front&limit=10'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Of this camera only. */
                    camera?: string;
                    /** @description At most this many; 50 without it. */
                    limit?: number;
                    /** @description Reports older than the one of this identity only: `next` of an answer, for the clips before those. */
                    before?: string;
                    /** @description Reports newer than the one of this identity only: the newest that is known, for the clips since. */
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
         * What happens on the node, as server-sent events
         * @description First the present state (counters, thresholds, detector), then each change. A reader that is too slow
         *     loses events; the event `lagged` has their number.
         *     `curl -N 'http://127.0.0.1:8080/api/v1/events?types=counters,clip'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description About this camera only. Events about the detector come all the same. */
                    camera?: string;
                    /**
                     * @description Names of the kinds wanted, separated by commas: `frame`, `late`, `clip`, `counters`, `threshold`,
                     *     `detector`. All of them without it.
                     */
                    types?: string;
                };
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description Events `frame`, `late`, `clip`, `counters`, `threshold`, `detector`, `lagged`. */
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "text/event-stream": string;
                    };
                };
                /** @description Too many streams. */
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["Problem"];
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
         * @description The node keeps the newest 1000 in memory, from level `info` on whatever standard error is to hear. No configured secret
         *     is in them. `curl 'http://127.0.0.1:8080/api/v1/log?limit=20'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Only lines after that number. */
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
         * @description As `/readyz`, with status 200 whatever the state: this is to be looked at, not to be probed.
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
            };
        };
        /**
         * Sets a target instead of a threshold
         * @description One of `recall` (against the detector, the lower end of its interval), `skip_rate` and `watts`, or null for none. A
         *     controller then moves the knob of all cameras together, inside its range; setting the threshold by hand switches it
         *     off.
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
         * Whether the process answers
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
         * Whether frames are processed as wanted, and by which execution provider
         * @description 503 while starting, and when a part fails that the node cannot do without. 200 with reasons when another part
         *     fails. `curl http://127.0.0.1:8080/readyz`
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
        /** @description A policy that has skipped nothing, and what to try. */
        Advice: {
            /**
             * Format: int64
             * @description Frames of those with objects.
             */
            followed: number;
            /**
             * Format: int64
             * @description Frames since the knob was turned last; the detector ran on every one.
             */
            frames: number;
            /** @description The knob's name. */
            knob: string;
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
         * @description The results of an audit, with 95 % intervals that include the missed frames. The reference is the detector, not the
         *     truth: a policy that keeps showing an object which the detector misses loses precision here although it may
         *     be right.
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
             * @description Detector time of these, seconds.
             */
            detector_s: number;
            /**
             * Format: int64
             * @description Skipped frames that were drawn.
             */
            drawn: number;
            /**
             * Format: int64
             * @description Those of them that the detector had no time for.
             */
            missed: number;
            precision?: components["schemas"]["AuditRate"] | null;
            recall?: components["schemas"]["AuditRate"] | null;
            /**
             * Format: int64
             * @description Boxes that were shown on them.
             */
            shown: number;
        };
        /** @description A share of boxes, with its interval at a confidence of 95 %. */
        AuditRate: {
            /**
             * Format: int64
             * @description The compared boxes.
             */
            boxes: number;
            /**
             * Format: double
             * @description Upper end of the interval: the same, with every box of the missed frames counted as a success.
             */
            high: number;
            /**
             * Format: double
             * @description How many independent boxes they are worth: the boxes of one frame are shown or missed together.
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
         * @description The audit's part of a clip report: results for skipped frames since the previous report. A frame at the end of a clip
         *     may be counted in the next report.
         */
        AuditReport: {
            /**
             * Format: int64
             * @description Detector calls for the audit; in none of the frame states and not in the skip rate.
             * @default 0
             */
            calls: number;
            /**
             * Format: int64
             * @description Detector time of these, microseconds.
             * @default 0
             */
            detector_us: number;
            /**
             * Format: double
             * @description Estimate of what that time added, joules, which are among the clip's: the watts that a running detector adds on this
             *     machine times `detector_us`. Absent while it is not known what it adds.
             * @default null
             */
            joules: number | null;
            /**
             * Format: double
             * @description Share of the skipped frames that is drawn.
             * @default 0
             */
            share: number;
            /**
             * @description What was compared and what was missed.
             * @default {}
             */
            sums: components["schemas"]["AuditSums"];
        };
        /** @description Sums over the compared frames of the squares and products of their counts, from which the intervals come. */
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
         * @description Sums over the drawn frames. A pooled rate is that of all compared boxes: of two cameras with as many boxes per frame, the
         *     one that audits the larger share of its frames weighs more.
         */
        AuditSums: {
            /**
             * Format: int64
             * @description Boxes that the detector found on them.
             * @default 0
             */
            detected: number;
            /**
             * Format: int64
             * @description Frames that were compared.
             * @default 0
             */
            frames: number;
            /**
             * Format: int64
             * @description Frames that were drawn and that the detector had no time for.
             * @default 0
             */
            missed: number;
            /**
             * Format: int64
             * @description Boxes that were shown on those, at least one per frame: what the missed frames weigh in an interval.
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
             * @description Boxes that were shown on them.
             * @default 0
             */
            shown: number;
            /**
             * @description How far the compared frames differ.
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
        /**
         * @description The state of the board during a clip, as far as the board reports it: the energy of a clip depends on
         *     it.
         */
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
             * @description Highest temperature of any sensor, °C.
             * @default null
             */
            hottest_celsius: number | null;
            /**
             * @description The sensor that read it.
             * @default null
             */
            hottest_sensor: string | null;
            /**
             * @description Power mode: `nvpmodel`'s name for it, else the platform profile of ACPI. Several, in order, when it
             *     changed.
             * @default null
             */
            power_mode: string | null;
            /**
             * @description Whether heat, current or power throttled the clocks at any time; absent if the board does not report it.
             * @default null
             */
            throttled: boolean | null;
        };
        /** @description One box of a [`DetectionsMessage`]. */
        BoxMessage: {
            /** @description Left, top, right, bottom in pixels of the source picture, clipped to it. */
            box: number[];
            /** @description Class name. */
            class: string;
            /**
             * Format: float
             * @description Confidence, 0 to 1.
             */
            confidence: number;
            /** @description Whether the object is confirmed. */
            confirmed: boolean;
            object?: components["schemas"]["ObjectId"] | null;
            /** @description Origin of the box. */
            source: components["schemas"]["BoxSource"];
        };
        /**
         * @description Where a reported box comes from.
         * @enum {string}
         */
        BoxSource: "detected" | "predicted" | "followed" | "rescued";
        /**
         * @description Why the detector was called for a frame, whether or not it answered. Where several things call it at once, the one
         *     named first here is said.
         * @enum {string}
         */
        CallCause: "uncertain" | "new_object" | "expected_loss" | "object_cap" | "periodic_cap" | "screen" | "audit" | "empty_limit" | "no_objects" | "start" | "retry" | "changed" | "schedule" | "every_frame";
        /** @description State of one camera. */
        CameraDetail: components["schemas"]["CameraEntry"] & {
            /**
             * Format: int64
             * @description Frames answered from prediction because the detector was not available.
             */
            degraded_frames: number;
            /** @description Frames not processed, by kind. */
            dropped: components["schemas"]["DroppedFrames"];
            knob?: components["schemas"]["Knob"] | null;
            /** @description The policy that decides its frames. */
            policy: string;
            set_by?: components["schemas"]["SettingSource"] | null;
            /**
             * Format: double
             * @description Share of frames that skipped the detector: state E or P and not degraded.
             */
            skip_rate: number;
            /** @description Number of frames in each state; they add up to `frames`. */
            states: components["schemas"]["FrameStates"];
            threshold?: components["schemas"]["Threshold"] | null;
            /** @description The program's version. */
            version: string;
        };
        /** @description A camera. */
        CameraEntry: {
            advice?: components["schemas"]["Advice"] | null;
            /** @description Its name. */
            camera: string;
            /**
             * Format: int64
             * @description Clips ended since the node started.
             */
            clips: number;
            /** @description Why no frames arrive, if none do. */
            fault?: string | null;
            /**
             * Format: int64
             * @description Frames processed since the node started.
             */
            frames: number;
            /**
             * Format: int32
             * @description Rows of its newest frame.
             */
            height?: number | null;
            /** @description Zenoh key its frames come on; absent where it has a source. */
            key?: string | null;
            /**
             * Format: double
             * @description Seconds since its newest frame; absent before the first.
             */
            last_frame_age_s?: number | null;
            /** @description Address of the source that the node opens for it, without credentials. */
            source?: string | null;
            /**
             * Format: double
             * @description The equivalent of `u` in the published code, in pictures of this size; absent where that is the same
             *     number, before the first frame, and under other policies.
             */
            u_as_published?: number | null;
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
             * Format: int64
             * @description Length of a piece of the hour, seconds.
             */
            slot_s: number;
            /** @description The last hour in pieces, the oldest first, the last one still open; those without a frame are left out. */
            slots: components["schemas"]["CameraSlot"][];
        };
        /** @description A piece of the last hour. */
        CameraSlot: {
            /**
             * Format: int64
             * @description When it began, milliseconds since the Unix epoch.
             */
            at_ms: number;
            /**
             * Format: int32
             * @description Frames that the detector was called for.
             */
            calls: number;
            /**
             * Format: int32
             * @description Of these, answered from prediction because the detector was not available.
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
             * @description Of these, without the detector: state E or P and not degraded.
             */
            skipped: number;
        };
        /**
         * @description Whether frames come from a camera.
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
            /** @description Its name. */
            name: string;
            /** @description Whether frames come. */
            state: components["schemas"]["CameraState"];
            threshold?: components["schemas"]["Threshold"] | null;
            /** @description Who set it. */
            threshold_source: components["schemas"]["SettingSource"];
        };
        /** @description One camera's threshold. */
        CameraThreshold: {
            /** @description Camera. */
            camera: string;
            knob?: components["schemas"]["Knob"] | null;
            /** @description Whether a value changed while running holds after a restart; absent in a list. */
            survives_restart?: boolean | null;
        };
        /** @description The cameras of a node. */
        Cameras: {
            /** @description In the order of the configuration. */
            cameras: components["schemas"]["CameraEntry"][];
        };
        /**
         * @description Why a clip ended.
         * @enum {string}
         */
        ClipEnd: "next_clip" | "window" | "silence" | "shutdown" | "length" | "other";
        /**
         * @description Energy of one clip.
         *
         *     Joules count only the time that samples cover; `coverage` is its share of the clip. They are never
         *     extrapolated, so with a coverage below [`FULL_COVERAGE`] (0.999) they are less than the clip used: do not
         *     compare such joules with others or divide them by the clip's duration. `edp` is then absent.
         */
        ClipEnergy: {
            /**
             * Format: double
             * @description Share of the clip's time that samples cover, 0 to 1.
             */
            coverage: number;
            /** @description Node energy by domain. */
            domains: components["schemas"]["DomainEnergy"][];
            /**
             * Format: double
             * @description Energy-delay product, J·ms/frame: clip energy × clip duration ÷ frames (paper, evaluation). Absent
             *     without frames, and when samples do not cover the whole clip (`coverage` below 0.999).
             */
            edp?: number | null;
            /**
             * Format: double
             * @description Joules of this clip, its share by the time the detector ran for its camera; absent when
             *     [`EnergyQuality::Unavailable`].
             */
            joules?: number | null;
            /**
             * Format: double
             * @description Joules of the whole node over the same time, of which `joules` is the clip's share. The same
             *     number when the node has one camera.
             */
            node_joules?: number | null;
            /** @description Quality of the figures. */
            quality: components["schemas"]["EnergyQuality"];
            /**
             * Format: int64
             * @description Samples inside the clip.
             */
            samples: number;
            /**
             * Format: double
             * @description Estimate of the joules that this clip's avoided detector calls would have added: the time they would have run, at
             *     most the detector's idle time, times the watts that a running detector adds on this machine. Absent until these
             *     watts are known.
             */
            saved_joules_estimated?: number | null;
            /** @description Where it comes from: `rapl`, `estimate`, … */
            source: string;
            /**
             * @description How `joules` of the total domain is computed: `input_rail`, `sum_of_rails`, or the estimate's
             *     formula in words.
             */
            total_from: string;
        };
        /** @description The report of one clip. */
        ClipReport: {
            audit?: components["schemas"]["AuditReport"] | null;
            board?: components["schemas"]["BoardState"] | null;
            /** @description Camera. */
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
            /** @description Latency of the detector alone, over the frames where it ran. */
            detector_latency_ms: components["schemas"]["Percentiles"];
            /**
             * Format: double
             * @description Time the detector ran for this clip's frames, milliseconds, without waiting and audit. A run for several
             *     pictures is divided evenly.
             */
            detector_used_ms?: number;
            /** @description Frames not processed, by kind. */
            dropped: components["schemas"]["DroppedFrames"];
            /**
             * Format: double
             * @description Seconds from the first frame's arrival to the clip's end.
             */
            duration_s: number;
            /** @description Why it ended. */
            ended_by: components["schemas"]["ClipEnd"];
            /** @description Energy. */
            energy: components["schemas"]["ClipEnergy"];
            /**
             * Format: int64
             * @description Frames processed; the five states add up to it.
             */
            frames: number;
            /**
             * Format: uuid
             * @description Id, a UUID of version 7 from the node's clock; it never changes.
             */
            id: string;
            /** @description Detector model: file name. */
            model: string;
            /** @description Node. */
            node: string;
            /**
             * Format: int32
             * @description Number of this part, from 0: a long clip is reported in parts.
             */
            part?: number;
            /** @description Policy. */
            policy: string;
            /** @description Execution provider that ran it. */
            provider: string;
            /**
             * Format: double
             * @description Share of frames that skipped the detector: state E or P and not degraded.
             */
            skip_rate: number;
            /**
             * Format: int64
             * @description First frame's capture time, nanoseconds since the Unix epoch.
             */
            started_ns: number;
            /** @description Frame states. */
            states: components["schemas"]["FrameStates"];
            threshold?: components["schemas"]["Threshold"] | null;
            /** @description Every value in force during the clip, in order: the one at the start, then the changes. */
            threshold_changes: components["schemas"]["ThresholdChange"][];
            /** @description Latency from reception until the answer is handed to Zenoh. */
            total_latency_ms: components["schemas"]["Percentiles"];
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
        };
        /** @description Recent clip reports, newest first. */
        Clips: {
            /** @description The reports, as published on Zenoh. */
            clips: components["schemas"]["ClipReport"][];
            /**
             * Format: uuid
             * @description To be given as `before` for the clips before these; absent when there are none in memory.
             */
            next?: string | null;
        };
        /** @description Notifies a node that its desired setting has changed. */
        ConfigChanged: {
            /**
             * Format: int64
             * @description Revision of the desired setting.
             */
            revision: number;
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
        };
        /** @description The counters of a camera, once per second. */
        CountersMessage: {
            audit?: components["schemas"]["AuditFigures"] | null;
            /** @description Frames that called the detector since the node started, by cause, including degraded ones. */
            calls?: {
                [key: string]: number;
            };
            /** @description Camera. */
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
             * @description Time, nanoseconds since the Unix epoch.
             */
            t_ns: number;
            target?: components["schemas"]["TargetReport"] | null;
            threshold?: components["schemas"]["Threshold"] | null;
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
            /** @description Power now by domain, watts; empty without a source. */
            watts: components["schemas"]["DomainWatts"][];
        };
        /** @description The answer with a node's desired setting. */
        Desired: {
            /**
             * Format: int64
             * @description Number of the desired setting; a lower one never replaces a higher. 0 when there never was one.
             */
            revision: number;
            /** @description The hub missed a status: send the full one. */
            send_full_status?: boolean;
            setting?: components["schemas"]["DesiredSetting"] | null;
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
            /**
             * Format: int32
             * @description How much longer the node is watched, seconds: until then it sends counters once per second. Absent if it is not
             *     watched.
             */
            watched_for_s?: number | null;
        };
        /** @description The desired setting of a node: a threshold or a target. A node has only one, so each kind replaces the other. */
        DesiredSetting: {
            /** @description A threshold: `{"threshold": {"name": "u", "value": 3e-4}}`. A target is switched off. */
            threshold: components["schemas"]["Threshold"];
        } | {
            target: components["schemas"]["Target"] | null;
        };
        /** @description The state and boxes of one frame. */
        DetectionsMessage: {
            /** @description What is in view. */
            boxes: components["schemas"]["BoxMessage"][];
            cause?: components["schemas"]["CallCause"] | null;
            /** @description Clip the frame belongs to. */
            clip: string;
            /** @description The detector was needed but not available; the boxes are predictions. */
            degraded?: boolean;
            /**
             * Format: int32
             * @description Rows of the picture.
             */
            height: number;
            /** @description Time of each step. */
            latency_ms: components["schemas"]["Latency"];
            /** @description The boxes are predictions made at once. The frame's final state and boxes follow on the camera's key `late`. */
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
             * @description Version.
             */
            v: number;
            /**
             * Format: int32
             * @description Columns of the picture.
             */
            width: number;
        };
        /** @description How the detector is doing. */
        DetectorEvent: {
            /** @description Execution provider that really runs it; absent while it starts. */
            provider?: string | null;
            /** @description What happened, when degraded. */
            reason?: string | null;
            /** @description `starting`, `ready` or `degraded`. */
            status: string;
        };
        /** @description Energy of one domain of the board. */
        DomainEnergy: {
            /** @description `total`, `gpu`, `cpu`, `io_mem`. */
            domain: string;
            /**
             * Format: double
             * @description Joules, over the time that samples cover.
             */
            joules: number;
            /**
             * Format: double
             * @description Mean power over the time that samples cover, watts.
             */
            mean_watts: number;
            /**
             * Format: double
             * @description Highest sample, watts; where the source counts energy, the highest mean between two samples. Absent
             *     without a sample inside the clip.
             */
            peak_watts?: number | null;
        };
        /** @description Power of one domain now. */
        DomainWatts: {
            /** @description `total`, `gpu`, `cpu`, `io_mem`. */
            domain: string;
            /**
             * Format: double
             * @description Watts.
             */
            watts: number;
        };
        /** @description Frames that were not processed, each kind under its own name. */
        DroppedFrames: {
            /**
             * Format: int64
             * @description Arrived again with the same sequence number.
             * @default 0
             */
            duplicate: number;
            /**
             * Format: int64
             * @description Arrived after a later frame (first counted as lost).
             * @default 0
             */
            late: number;
            /**
             * Format: int64
             * @description Never arrived: numbers missing in the sequence.
             * @default 0
             */
            lost: number;
            /**
             * Format: int64
             * @description Pushed out of the ring by a newer one before its turn.
             * @default 0
             */
            overrun: number;
            /**
             * Format: int64
             * @description Payload, picture or decompressed size above the limit.
             * @default 0
             */
            oversized: number;
            /**
             * Format: int64
             * @description Arrived or waited while the camera's loop was not running, after a failure or while stopping.
             * @default 0
             */
            stopped: number;
            /**
             * Format: int64
             * @description From another stream than the camera's current one: another publisher, or a number far off.
             * @default 0
             */
            stray: number;
            /**
             * Format: int64
             * @description The picture could not be decoded, or contradicts its own header.
             * @default 0
             */
            undecodable: number;
            /**
             * Format: int64
             * @description A payload encoding that is not known, or an attachment that cannot be read.
             * @default 0
             */
            unknown_format: number;
        };
        /**
         * @description How far an energy figure can be trusted; the order is from most to least.
         * @enum {string}
         */
        EnergyQuality: "measured" | "partial" | "estimated" | "unavailable";
        /** @description What the whole node has used since it started. */
        EnergySinceStart: {
            /** @description That time, seconds. */
            covered_s: {
                [key: string]: number;
            };
            /** @description Joules by domain, over the time that samples cover. */
            joules: {
                [key: string]: number;
            };
            /** @description How far to trust them. */
            quality: components["schemas"]["EnergyQuality"];
            /** @description Where the figures come from: `rapl`, `estimate`, …; `none` without a source. */
            source: string;
        };
        /** @description What the whole node used over a time. */
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
            /** @description How far to trust the joules: partial where the meter had gaps. */
            quality: components["schemas"]["EnergyQuality"];
            /**
             * Format: double
             * @description Estimate of what the avoided calls would have added, joules: the time they would have run, no longer than the one
             *     detector had nothing to do, times the watts that a running detector adds on this machine. Null while it is not
             *     known what it adds.
             */
            saved_joules_estimated?: number | null;
        };
        /** @description What is wrong with a part. */
        Fault: {
            /** @description `not_ready` when the service cannot do its work, `degraded` when it works beside the fault. */
            effect: components["schemas"]["HealthState"];
            /** @description What is wrong, for people. No number that moves by itself belongs here: each new text is a change. */
            reason: string;
        };
        /**
         * @description The node's answer to a frame that arrived as a query, sent when the frame's turn comes: the sender of a camera with
         *     `delivery = "every"` then sends its next frame. If a query ends without an answer, the frame was not accepted.
         */
        FrameAnswer: {
            /** @description Why the frame will not be processed; absent when it will be. */
            refused?: string | null;
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
        };
        /** @description What a camera may add to a frame, in the attachment of its sample. */
        FrameAttachment: {
            /** @description Clip the frame belongs to. Without it clips are fixed time windows. */
            clip?: string | null;
            /**
             * Format: int32
             * @description Rows of a raw picture.
             */
            height?: number | null;
            /**
             * Format: int64
             * @description Sequence number, one more for each frame. Without it frames are numbered by arrival.
             */
            seq?: number | null;
            /**
             * Format: int64
             * @description Numbering that `seq` belongs to: a sender that restarts uses another number, such as its start time in
             *     nanoseconds, and then loses no frame.
             */
            stream?: number | null;
            /**
             * Format: int64
             * @description Capture time, nanoseconds since the Unix epoch. Without it the sample's timestamp counts.
             */
            t_ns?: number | null;
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
            /**
             * Format: int32
             * @description Columns of a raw picture.
             */
            width?: number | null;
        };
        /** @description What became of frames since the node started. */
        FrameCounts: {
            audit?: components["schemas"]["AuditFigures"] | null;
            /** @description Frames that the detector was called for, by cause; degraded ones are among them. */
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
             * @description Detector with at least one rescue.
             */
            AI: number;
            /**
             * Format: int64
             * @description Screen says empty, detector skipped.
             */
            E: number;
            /**
             * Format: int64
             * @description Screen, then detector.
             */
            "E+I": number;
            /**
             * Format: int64
             * @description Detector.
             */
            I: number;
            /**
             * Format: int64
             * @description Predicted boxes, detector skipped.
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
         * @description Whether a node works as it should.
         * @enum {string}
         */
        HealthState: "ready" | "degraded" | "not_ready";
        /** @description Health with its reasons. */
        HealthStatus: {
            /** @description What is wrong, by part; empty when ready. */
            reasons: {
                [key: string]: string;
            };
            /** @description Whether it works as it should. */
            state: components["schemas"]["HealthState"];
        };
        /** @description Service, version and list of routes. */
        Index: {
            /** @description Names of the cameras. */
            cameras: string[];
            /** @description The node's name. */
            node: string;
            /** @description The interface described in full. */
            openapi: string;
            /** @description The policy that decides the frames. */
            policy: string;
            /** @description What can be asked. */
            routes: components["schemas"]["Route"][];
            /** @description The program's version. */
            version: string;
        };
        /** @description The one number of a policy that a user turns while it runs, as the policy declares it. */
        Knob: {
            /**
             * Format: double
             * @description The value without configuration.
             */
            default: number;
            /**
             * Format: double
             * @description Largest value allowed.
             */
            maximum: number;
            /** @description What turning it does, in one sentence. */
            meaning: string;
            /**
             * Format: double
             * @description Smallest value allowed.
             */
            minimum: number;
            /** @description Its name in configuration, messages and reports: `u`, `lambda`, … */
            name: string;
            /**
             * Format: double
             * @description Where a slider ends: above it hardly anything more is saved, at a high price.
             */
            useful_maximum: number;
            /**
             * Format: double
             * @description Where a slider begins: below it hardly anything is saved.
             */
            useful_minimum: number;
        };
        /** @description Between which values a controller moves a knob. */
        KnobRange: {
            /**
             * Format: double
             * @description Smallest value: the most accurate one.
             */
            least: number;
            /**
             * Format: double
             * @description Largest value: what accuracy still allows.
             */
            most: number;
        };
        /** @description Time of each step of one frame, milliseconds. A step that did not happen is absent. */
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
             * @description The empty-scene screen, with its preprocessing.
             */
            screen?: number | null;
            /**
             * Format: double
             * @description From reception to the answer, before it is written as JSON and published; without the time in Zenoh.
             */
            total: number;
            /**
             * Format: double
             * @description Waiting in the ring for the camera's loop.
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
             * @description When, milliseconds since the Unix epoch.
             */
            at_ms: number;
            /** @description `ERROR`, `WARN`, `INFO`, `DEBUG` or `TRACE`. */
            level: string;
            /**
             * Format: int64
             * @description Its number since the start, from 1.
             */
            number: number;
            /** @description Part of the program that wrote it. */
            target: string;
            /** @description Spans, message and fields. */
            text: string;
        };
        /** @description A new threshold: `{"u": 3e-4}`, or `{"lambda": 0.3}` under expected-loss. */
        NewThreshold: {
            /**
             * Format: int32
             * @description Version of the message; may be left out.
             */
            v?: number | null;
        };
        /** @description A node: how it is, since when it runs, and what it has used since. */
        NodeOverview: components["schemas"]["Readiness"] & {
            /** @description Energy since the start. */
            energy: components["schemas"]["EnergySinceStart"];
            /** @description Reports that wait for a hub. */
            outbox: components["schemas"]["OutboxStatus"];
            /** @description What was saved since the start. */
            since_start: components["schemas"]["Savings"];
            /** @description What was saved today: since midnight UTC, or since the start where that is later. */
            today: components["schemas"]["Savings"];
            /**
             * Format: double
             * @description Seconds since it started.
             */
            uptime_s: number;
            /** @description The program's version. */
            version: string;
        };
        /** @description What became of all frames since the node started. */
        NodeStates: components["schemas"]["FrameCounts"] & {
            /** @description Each camera's. */
            cameras: components["schemas"]["CameraStates"][];
            /** @description Node. */
            node: string;
            /**
             * Format: double
             * @description Seconds since it started.
             */
            uptime_s: number;
        };
        /** @description Everything a hub shows of a node between reports. */
        NodeStatus: {
            /** @description Cameras. */
            cameras: components["schemas"]["CameraStatus"][];
            /** @description Health with its reasons. */
            health: components["schemas"]["HealthStatus"];
            /** @description Labels of its configuration, for selecting nodes: `region = "north"`. */
            labels?: {
                [key: string]: string;
            };
            /** @description Detector model: file name. */
            model: string;
            /** @description The outbox. */
            outbox: components["schemas"]["OutboxStatus"];
            /** @description Policy. */
            policy: string;
            /** @description How far they can be trusted. */
            power_quality: components["schemas"]["EnergyQuality"];
            /** @description Where power figures come from: `rapl`, `estimate`, … */
            power_source: string;
            /** @description Execution provider that really runs it; absent until the model is loaded. */
            provider?: string | null;
            refused?: components["schemas"]["RefusedDesired"] | null;
            target?: components["schemas"]["NodeTarget"] | null;
            /** @description Why it has no target any more, in words, if it had one since its start. */
            target_off?: string | null;
            /** @description Version of the program. */
            version: string;
        };
        /** @description The target in a node's status, without the figures that change all the time. */
        NodeTarget: {
            /**
             * Format: double
             * @description The measured value when the status was created.
             */
            actual?: number | null;
            /** @description Who set it. */
            source: components["schemas"]["SettingSource"];
            status?: components["schemas"]["TargetStatus"] | null;
            /** @description The target. */
            target: components["schemas"]["Target"];
        };
        /** @description [`Readiness`] as a problem document. */
        NotReady: components["schemas"]["Problem"] & components["schemas"]["Readiness"];
        /**
         * Format: int64
         * @description Number of an object within a stream, from 0, never used twice.
         */
        ObjectId: number;
        /** @description The outbox of a [`NodeStatus`]. */
        OutboxStatus: {
            /** @description Whether reports survive a power loss; `false` without a state directory or when its disk fails. */
            durable: boolean;
            /**
             * Format: int64
             * @description Reports lost: the outbox was full or its disk broken.
             */
            lost: number;
            /**
             * Format: int64
             * @description Reports that the hub refused for good.
             */
            undeliverable?: number;
            /**
             * Format: int64
             * @description Reports that wait.
             */
            waiting: number;
        };
        /** @description What is wrong with one of the service's parts. */
        PartFault: components["schemas"]["Fault"] & {
            /** @description The part: `detector`, `zenoh`, … */
            part: string;
            /**
             * Format: double
             * @description Seconds since the part is at fault, whatever the reasons were meanwhile.
             */
            since_s: number;
            /** @description Which of several: the name of a camera or a task. Absent where it is the part itself. */
            subject?: string | null;
        };
        /** @description The last frames, column by column: the n-th entry of each is of the n-th frame, the oldest first. */
        PastFrames: {
            /** @description Milliseconds before `now_ms` that it was answered. */
            age_ms: number[];
            /** @description Boxes reported. */
            boxes: number[];
            /** @description Why the detector was called; null where it was not. */
            cause: (components["schemas"]["CallCause"] | null)[];
            /** @description Whether the detector was needed but not available. */
            degraded: boolean[];
            /** @description Milliseconds of the detector; null where it did not run. */
            detector_ms: (number | null)[];
            /** @description Sequence number. */
            seq: number[];
            /** @description Frame state. */
            state: components["schemas"]["FrameState"][];
            /** @description Largest uncertainty before the decision; null without objects. */
            tau_max: (number | null)[];
            /** @description Threshold in force; null where the policy has none. */
            threshold: (number | null)[];
            /** @description Milliseconds from reception to publication. */
            total_ms: number[];
        };
        /** @description Middle and tail of a set of durations, milliseconds. */
        Percentiles: {
            /**
             * Format: int64
             * @description How many durations.
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
        /** @description Power over the last hour. */
        PowerHistory: {
            /**
             * Format: int64
             * @description Length of a piece, seconds.
             */
            slot_s: number;
            /** @description The pieces that are over, the oldest first; those without a figure are left out. */
            slots: components["schemas"]["PowerPiece"][];
        };
        /** @description Power of a piece of the last hour. */
        PowerPiece: {
            /**
             * Format: int64
             * @description When it began, milliseconds since the Unix epoch.
             */
            at_ms: number;
            /** @description How far to trust it: the worst during the piece. */
            quality: components["schemas"]["EnergyQuality"];
            /** @description Mean power over the time that samples cover, watts, by domain. */
            watts: {
                [key: string]: number;
            };
        };
        /** @description What went wrong with a request, and what would do. */
        Problem: {
            /** @description What is allowed instead of what was sent: methods, names, media types. */
            allowed?: string[];
            /** @description What was wrong with this request. */
            detail: string;
            knob?: components["schemas"]["Knob"] | null;
            /**
             * Format: int32
             * @description The HTTP status.
             */
            status: number;
            /** @description The status in words. */
            title: string;
            /** @description Always `about:blank`: the title is that of the status. */
            type: string;
        };
        /** @description A node's request for its desired setting. */
        PullRequest: {
            /**
             * Format: int64
             * @description Revision it has, 0 for none.
             */
            revision: number;
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
        };
        /** @description Whether frames are processed as the configuration wants it, and by what. */
        Readiness: {
            /** @description File name of the detector's model. */
            model: string;
            /** @description The node. */
            node: string;
            /** @description The policy that decides frames. */
            policy: string;
            /** @description Execution provider that really runs the detector; absent while it starts. */
            provider?: string | null;
            /** @description Whether frames are answered as wanted, perhaps with a part missing. */
            ready: boolean;
            /** @description What is wrong; empty when every part works. */
            reasons: components["schemas"]["PartFault"][];
            /** @description Execution providers asked for, in order. */
            requested_providers: string[];
            /** @description Whether every part works. */
            state: components["schemas"]["HealthState"];
        };
        /** @description A desired value that a node did not take. */
        RefusedDesired: {
            /** @description Why, in words: the policy has another threshold, or the value is outside of its range. */
            reason: string;
            /**
             * Format: int64
             * @description Its revision: greater than the one in force.
             */
            revision: number;
        };
        /** @description A report that a hub will never store. */
        RefusedReport: {
            /**
             * Format: uuid
             * @description Its identity.
             */
            id: string;
            /** @description Why, in words. */
            reason: string;
        };
        /** @description The acknowledgement of a batch, sent after the hub's commit: every report of it is stored, but those that are refused. */
        ReportAnswer: {
            /**
             * Format: uuid
             * @description Identity of the hub's database. One that the node does not know has none of its reports: it sends again what it
             *     still has.
             */
            database: string;
            desired?: components["schemas"]["Desired"] | null;
            /**
             * @description Running counts of the node ([`ClipReport::count`]) that never came, from the first to the last of each range: the node
             *     sends again what it still has of them.
             */
            missing?: [
                number,
                number
            ][];
            /** @description Reports that will never be stored: they are too old, or make no sense. */
            refused?: components["schemas"]["RefusedReport"][];
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
        };
        /**
         * @description Reports of one node, the oldest first. On the wire: a byte with the dictionary's number, then JSON compressed with
         *     Zstandard and that dictionary (`crates/wire/src/report/dictionary-1.json`).
         */
        ReportBatch: {
            /** @description Node; the same in each of the reports. */
            node: string;
            /** @description The reports. */
            reports: components["schemas"]["ClipReport"][];
            /**
             * Format: int64
             * @description The node's clock when it sent the batch, milliseconds since the Unix epoch: a hub sees from it whether the times in
             *     the reports can be believed.
             */
            t_ms: number;
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
        };
        /** @description A route. */
        Route: {
            /** @description `GET`, `PUT`, `POST` or `DELETE`. */
            method: string;
            /** @description Its path; `{camera}` is replaced by a camera's name. */
            path: string;
            /** @description What it is for. */
            summary: string;
        };
        /** @description What was saved over a time. */
        Savings: {
            /**
             * Format: int64
             * @description Detector calls avoided: frames answered without it, degraded ones not among them.
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
             * @description From when on, milliseconds since the Unix epoch: the node's start, or midnight UTC where that is later.
             */
            since_ms: number;
        };
        /**
         * @description Who set a threshold or a target.
         * @enum {string}
         */
        SettingSource: "configuration" | "local" | "hub";
        /** @description The boxes of one frame for recordings: interpolated between two detector calls if the second came in time. */
        SettledMessage: {
            /** @description What is in view. */
            boxes: components["schemas"]["BoxMessage"][];
            /** @description Clip the frame belongs to. */
            clip: string;
            /**
             * Format: int32
             * @description Rows of the picture.
             */
            height: number;
            /**
             * Format: int64
             * @description Sequence number of the frame.
             */
            seq: number;
            /** @description False for a frame whose boxes are those it was answered with, because no later detector call came in time. */
            settled: boolean;
            /** @description Frame state. */
            state: components["schemas"]["FrameState"];
            /**
             * Format: int64
             * @description Capture time, nanoseconds since the Unix epoch.
             */
            t_ns: number;
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
            /**
             * Format: int32
             * @description Columns of the picture.
             */
            width: number;
        };
        /** @description What other thresholds would have skipped over the last frames. */
        SkipEstimate: {
            /**
             * Format: double
             * @description Time they took, seconds.
             */
            duration_s: number;
            /** @description Frames looked at. */
            frames: number;
            /**
             * Format: double
             * @description Share of the frames, really.
             */
            skip_rate: number;
            /** @description Frames that really were answered without the detector. */
            skipped: number;
            /** @description What each value would have skipped, in the order asked for. */
            values: components["schemas"]["ValueEstimate"][];
        };
        /** @description What other thresholds would have skipped over the last minutes. */
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
         * @description A heartbeat with the full status when it changed or was requested. If only the number of waiting reports has changed,
         *     the node sends a [`Heartbeat`] instead.
         */
        StatusMessage: {
            full?: components["schemas"]["NodeStatus"] | null;
            /** @description Whether it works as it should. */
            health: components["schemas"]["HealthState"];
            /**
             * Format: int64
             * @description Revision of the desired value that is in force; 0 when none is.
             */
            revision: number;
            /**
             * Format: int32
             * @description A random number of this run of the process: it distinguishes two runs, and two nodes with the same name.
             */
            run: number;
            /**
             * Format: int64
             * @description Number of this message within the run, from 0; a gap makes the hub ask for the full status.
             */
            seq: number;
            /**
             * Format: int64
             * @description When the process started, nanoseconds since the Unix epoch.
             */
            started_ns: number;
            /**
             * Format: int64
             * @description The node's clock, nanoseconds since the Unix epoch.
             */
            t_ns: number;
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
            /**
             * Format: int64
             * @description Reports that wait in the outbox.
             */
            waiting: number;
        };
        /** @description What is to be held. As JSON one field: `{"skip_rate": 0.5}`. */
        Target: {
            /**
             * Format: double
             * @description Recall against the detector: the lower end of its interval is held at this.
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
         * @description A target, in a put, in a query's payload and in a request: `{"target": {"skip_rate": 0.5}}`, or `{"target": null}` for
         *     none.
         */
        TargetMessage: {
            target?: components["schemas"]["Target"] | null;
            /**
             * Format: int32
             * @description Version; may be left out on the way in.
             */
            v?: number;
        };
        /** @description The target of a node and its state. */
        TargetReport: {
            /** @description Why there is none any more, in words. */
            off?: string | null;
            range?: components["schemas"]["KnobRange"] | null;
            /** @description Who set it, or switched it off. */
            source: components["schemas"]["SettingSource"];
            state?: components["schemas"]["TargetState"] | null;
            target?: components["schemas"]["Target"] | null;
            threshold?: components["schemas"]["Threshold"] | null;
            /**
             * Format: int32
             * @description Version.
             */
            v: number;
            /** @description The same in words. */
            why?: string | null;
        };
        /** @description The state of a target. */
        TargetState: {
            /**
             * Format: double
             * @description What is measured of it; for recall the lower end of its interval. Absent before anything is.
             */
            actual?: number | null;
            /**
             * Format: int64
             * @description For recall, the boxes that the figure rests on.
             */
            boxes?: number | null;
            /**
             * Format: double
             * @description The knob's value in force.
             */
            knob: number;
            /** @description Why it has that value. */
            status: components["schemas"]["TargetStatus"];
            /**
             * Format: int64
             * @description How often that began.
             */
            unmet: number;
            /**
             * Format: double
             * @description Seconds in which the target could not be met inside the range.
             */
            unmet_s: number;
        };
        /**
         * @description Why the knob has its value.
         * @enum {string}
         */
        TargetStatus: "measuring" | "moving" | "held" | "more_than_kept" | "cannot_be_met" | "no_frames" | "no_power" | "no_audit";
        /**
         * @description The value of a policy's threshold, with the name that the policy gives it: `{"name": "u", "value": 3e-4}`, or `lambda`
         *     under expected-loss. So one policy's value cannot be mistaken for another's.
         */
        Threshold: {
            /** @description The threshold's name. */
            name: string;
            /**
             * Format: double
             * @description The value.
             */
            value: number;
        };
        /** @description A change of the threshold during a clip. */
        ThresholdChange: {
            /**
             * Format: int64
             * @description First frame that it applies to.
             */
            seq: number;
            /** @description The new value. */
            threshold: components["schemas"]["Threshold"];
        };
        /** @description A threshold changed; it holds from the camera's next frame. */
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
             * @description Version; may be left out on the way in.
             */
            v?: number;
        };
        /** @description The thresholds of a node. */
        Thresholds: {
            /** @description Each camera's. */
            cameras: components["schemas"]["CameraThreshold"][];
            /**
             * @description Whether values changed while running hold after a restart: a `state_dir` is set and can be
             *     written to.
             */
            survives_restart: boolean;
        };
        /** @description What one value would have skipped. */
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
        /** @description Who asks. */
        WhoAsks: {
            /** @description Whether the caller may change something, and not only look. */
            may_tune: boolean;
            /** @description Name of the token; `anonymous` without one. */
            name: string;
            /** @description Whether what is asked of this interface needs a token that did not come with the request. */
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
