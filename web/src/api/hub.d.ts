// Made by `npm run types` from api/hub.json. Do not edit.

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
         * @description `curl http://127.0.0.1:8090/api/v1`
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
    "/api/v1/clips": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Clips by node, camera and time, page by page
         * @description `curl 'http://127.0.0.1:8090/api/v1/clips?node=car-7&limit=20'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Only of this node. */
                    node?: string;
                    /** @description Only of this camera of that node. */
                    camera?: string;
                    /** @description Only clips that began at this time or later, milliseconds since the Unix epoch. */
                    since_ms?: number;
                    /** @description Only clips that began before this time, milliseconds since the Unix epoch. */
                    until_ms?: number;
                    /** @description `next` of the previous page. */
                    cursor?: number;
                    /** @description Maximum number, up to 1000; 100 by default. */
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
                        "application/json": components["schemas"]["ClipPage"];
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
    "/api/v1/clips.csv": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Clips as CSV: all of them, or at most `limit`
         * @description The hub reads and sends them in pages, so the file may be larger than its memory. The audit's figures are left out.
         *     `curl -O 'http://127.0.0.1:8090/api/v1/clips.csv?since_ms=1790000000000'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Only of this node. */
                    node?: string;
                    /** @description Only of this camera of that node. */
                    camera?: string;
                    /** @description Only clips that began at this time or later, milliseconds since the Unix epoch. */
                    since_ms?: number;
                    /** @description Only clips that began before this time, milliseconds since the Unix epoch. */
                    until_ms?: number;
                    /** @description `next` of the previous page. */
                    cursor?: number;
                    /** @description Maximum number, up to 1000; 100 by default. */
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
                        "text/csv": string;
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
         * @description The archive contains versions, the configuration with its secrets masked, readiness, the nodes that are not online,
         *     metrics, the last events and revisions, and the last lines of the log. If the database cannot be read, the error is in
         *     place of events and revisions.
         *     `curl -O -J http://127.0.0.1:8090/api/v1/diag`
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
    "/api/v1/drift": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Nodes whose setting differs from the desired one
         * @description These nodes applied the desired setting, and somebody changed it at the node since then.
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
                        "application/json": components["schemas"]["Drift"][];
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
    "/api/v1/energy": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Energy over time and fleet, separately measured, partial and estimated, and compared with vanilla
         * @description `curl 'http://127.0.0.1:8090/api/v1/energy?by=policy'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description `all`, `node`, `camera`, `day`, `policy`, `threshold` or `clip`. */
                    by?: components["schemas"]["EnergyBy"];
                    /** @description Only clips that began at this time or later, milliseconds since the Unix epoch; seven days ago by default. */
                    since_ms?: number;
                    /** @description Only clips that began before this time; now by default. */
                    until_ms?: number;
                    /** @description Only of this node. */
                    node?: string;
                    /** @description `group`, or `joules` for the groups with the most energy first. A group has one entry for each quality. */
                    sort?: components["schemas"]["Sort"];
                    /** @description Maximum number of groups, up to 10000; 1000 by default. */
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
                        "application/json": components["schemas"]["Energy"];
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
         * The fleet's events, as server-sent events
         * @description Kinds: `node` (its state changed), `gap`, `reset`, `set_aside`, `clock_off`, `refused`, `drift` (a value was changed
         *     at the node), `forgotten`, and `resync`: too many events were missed, so read the present state again.
         *     `curl -N http://127.0.0.1:8090/api/v1/events`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Number of the last event that the reader has; the header `Last-Event-ID` takes precedence. */
                    last_event_id?: number;
                    /** @description Only these kinds, separated by commas; all kinds by default. */
                    types?: string;
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
    "/api/v1/nodes": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The nodes of the fleet
         * @description `curl 'http://127.0.0.1:8090/api/v1/nodes?state=degraded,silent&select=region=north&sort=waiting&down=true'`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Only nodes in these states, separated by commas: `degraded,silent`. */
                    state?: string;
                    /** @description Only nodes with this text in the name. */
                    search?: string;
                    /** @description Only nodes that match these names, globs and labels, separated by commas: `cam-*,region=north`. */
                    select?: string;
                    /** @description The sort order. */
                    sort?: "name" | "state" | "since" | "heard" | "waiting" | "joules";
                    /** @description Reverses the order. */
                    down?: boolean;
                    /** @description The number of rows to skip. */
                    offset?: number;
                    /** @description Maximum number, up to 1000; 100 by default; 0 for the counts alone. */
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
                        "application/json": components["schemas"]["NodeList"];
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
    "/api/v1/nodes/{node}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * One node with the counts of its reports
         * @description `curl http://127.0.0.1:8090/api/v1/nodes/car-7`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description Its name */
                    node: string;
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
                        "application/json": components["schemas"]["NodeDetail"];
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
        /**
         * Forgets a node
         * @description It is removed from the lists, and its desired setting is dropped; its clips, sums and history stay. A node that is
         *     online or degraded, or takes part in a rollout or trial, is not forgotten. A node that comes back is a new node.
         *
         *     `curl -X DELETE http://127.0.0.1:8090/api/v1/nodes/car-7`
         */
        delete: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description Its name */
                    node: string;
                };
                cookie?: never;
            };
            requestBody?: never;
            responses: {
                /** @description It is forgotten. */
                204: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content?: never;
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
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/nodes/{node}/cameras/{camera}/frame.jpg": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The newest picture of a node's camera
         * @description The node sends pictures only on request. The header `albireo-frame` has the sequence number of the frame.
         *     `curl -o frame.jpg 'http://127.0.0.1:8090/api/v1/nodes/car-7/cameras/front/frame.jpg?boxes=true'`
         */
        get: {
            parameters: {
                query?: {
                    /**
                     * @description True for the newest answered picture with its boxes: solid where detected, dashed where predicted. A node of an older
                     *     version sends it without.
                     */
                    boxes?: boolean;
                };
                header?: never;
                path: {
                    /** @description Its name */
                    node: string;
                    /** @description The camera's name */
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
    "/api/v1/nodes/{node}/live": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The counters of one node's cameras, once per second, as server-sent events
         * @description The node sends them only while this stream is read, and for 30 s after that. There is one event `counters` per
         *     camera and second.
         *     `curl -N http://127.0.0.1:8090/api/v1/nodes/car-7/live`
         */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description Its name */
                    node: string;
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
    "/api/v1/positions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        post?: never;
        /**
         * Deletes where a node's clips were made
         * @description The clips stay, and so do the sums of distance, which name no place. Reports that the node still has are stored with their
         *     positions when they come. `curl -X DELETE 'http://127.0.0.1:8090/api/v1/positions?node=car-7'`
         */
        delete: {
            parameters: {
                query: {
                    /** @description Of this node. */
                    node: string;
                    /** @description Only of clips that began before this time, milliseconds since the Unix epoch; all by default. */
                    until_ms?: number;
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
                        "application/json": components["schemas"]["Deleted"];
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
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/positions.geojson": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Where clips were made, as GeoJSON for QGIS and Grafana's Geomap
         * @description Only of nodes that know their position. `curl -o positions.geojson http://127.0.0.1:8090/api/v1/positions.geojson`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Only of this node. */
                    node?: string;
                    /** @description Only of cameras of this name. */
                    camera?: string;
                    /** @description Only clips that began at this time or later, milliseconds since the Unix epoch; a day ago by default. */
                    since_ms?: number;
                    /** @description Only clips that began before this time; all by default, also those of a node whose clock is ahead. */
                    until_ms?: number;
                    /** @description Maximum number of clips, up to 5000; 1000 by default. */
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
                        "application/geo+json": components["schemas"]["Positions"];
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
    "/api/v1/revisions": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * The history of desired settings
         * @description Each revision has its author, nodes, setting, reason and outcome.
         */
        get: {
            parameters: {
                query?: {
                    /** @description Only those that gave this node a setting. */
                    node?: string | null;
                    /** @description Only those with a lower number. */
                    before?: number | null;
                    /** @description Maximum number, up to 500; 50 by default. */
                    limit?: number | null;
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
                        "application/json": components["schemas"]["Revisions"];
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
    "/api/v1/revisions/{revision}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** One revision with every node */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description Its number. */
                    revision: number;
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
                        "application/json": components["schemas"]["Revision"];
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
    "/api/v1/rollouts": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Rollouts, the newest first */
        get: {
            parameters: {
                query?: {
                    /** @description Only those with a lower number. */
                    before?: number | null;
                    /** @description Maximum number, up to 200; 20 by default. */
                    limit?: number | null;
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
                        "application/json": components["schemas"]["Runs"];
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
        /**
         * Begins a rollout
         * @description The body is its plan with the new threshold beside it:
         *     `{"u": 5e-4, "select": ["cam-*"], "stages": ["1", "10%", "50%", "90%"], "soak_s": 1800, "gates": ["joules<=+5%"]}`.
         */
        post: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["RolloutPlan"];
                };
            };
            responses: {
                201: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Run"];
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
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/rollouts/{id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** A rollout with its record and its nodes */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description Its number. */
                    id: number;
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
                        "application/json": components["schemas"]["Run"];
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
    "/api/v1/rollouts/{id}/{command}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /** Pauses, resumes, advances, returns or stops a rollout */
        post: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description Its number. */
                    id: number;
                    /** @description `pause`, `resume`, `next`, `return` or `stop`. */
                    command: components["schemas"]["Command"];
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
                        "application/json": components["schemas"]["Run"];
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
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/set-aside": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /**
         * Invalid reports, with the reasons
         * @description The hub acknowledges them, so that they do not hold up later reports, and keeps them here.
         *     `curl http://127.0.0.1:8090/api/v1/set-aside`
         */
        get: {
            parameters: {
                query?: {
                    /** @description Only of this node. */
                    node?: string;
                    /** @description `next` of the previous page. */
                    cursor?: number;
                    /** @description Maximum number, up to 100; 20 by default. */
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
                        "application/json": components["schemas"]["AsidePage"];
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
    "/api/v1/target": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        /**
         * Sets a target on selected nodes instead of a threshold
         * @description A node has the target once it **reports** the target; its status says whether the target is met. A threshold that is
         *     set later, here or at the node, switches the target off; `"target": null` does so and keeps the threshold. Otherwise
         *     this works like `/api/v1/threshold`.
         *     `curl -X PUT -d '{"target": {"skip_rate": 0.5}, "select": ["cam-*"]}' http://127.0.0.1:8090/api/v1/target`
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
                    "application/json": components["schemas"]["NewRevision"];
                };
            };
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Revision"];
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
        get?: never;
        /**
         * Sets a value on selected nodes
         * @description A node has the value once it **reports** the value. With `Accept: application/x-ndjson` the outcome of each node is
         *     streamed; otherwise the answer waits a few seconds for the nodes. A node that is out of reach gets the value when it
         *     returns. The value switches off a node's target.
         *     `curl -X PUT -d '{"u": 5e-4, "select": ["cam-*"]}' http://127.0.0.1:8090/api/v1/threshold`
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
                    "application/json": components["schemas"]["NewRevision"];
                };
            };
            responses: {
                200: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Revision"];
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
    "/api/v1/trials": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** Trials, the newest first */
        get: {
            parameters: {
                query?: {
                    /** @description Only those with a lower number. */
                    before?: number | null;
                    /** @description Maximum number, up to 200; 20 by default. */
                    limit?: number | null;
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
                        "application/json": components["schemas"]["Runs"];
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
        /**
         * Begins a trial
         * @description `{"values": [{"u": 1e-4}, {"u": 3e-4}], "select": ["cam-*"], "duration_s": 3600}`
         */
        post: {
            parameters: {
                query?: never;
                header?: never;
                path?: never;
                cookie?: never;
            };
            requestBody: {
                content: {
                    "application/json": components["schemas"]["TrialPlan"];
                };
            };
            responses: {
                201: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/json": components["schemas"]["Run"];
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
        delete?: never;
        options?: never;
        head?: never;
        patch?: never;
        trace?: never;
    };
    "/api/v1/trials/{id}": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        /** A trial with its result and its nodes */
        get: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description Its number. */
                    id: number;
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
                        "application/json": components["schemas"]["Run"];
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
    "/api/v1/trials/{id}/end": {
        parameters: {
            query?: never;
            header?: never;
            path?: never;
            cookie?: never;
        };
        get?: never;
        put?: never;
        /**
         * Ends a trial before its time
         * @description The measurements until now are its result; the old values return.
         */
        post: {
            parameters: {
                query?: never;
                header?: never;
                path: {
                    /** @description Its number. */
                    id: number;
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
                        "application/json": components["schemas"]["Run"];
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
         * @description `curl http://127.0.0.1:8090/healthz`
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
         * Metrics of the hub
         * @description `curl http://127.0.0.1:8090/metrics`
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
         * Whether the hub accepts reports: the database can be written, and the Zenoh session is open
         * @description `curl http://127.0.0.1:8090/readyz`
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
                        "application/json": components["schemas"]["HubReadiness"];
                    };
                };
                503: {
                    headers: {
                        [name: string]: unknown;
                    };
                    content: {
                        "application/problem+json": components["schemas"]["HubNotReady"];
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
        /** @description A figure of one group of a trial. */
        ArmFigure: {
            /**
             * Format: double
             * @description Mean over these nodes before.
             */
            before: number;
            /**
             * Format: int64
             * @description The number of their clips during the trial.
             */
            clips: number;
            difference?: components["schemas"]["Interval"] | null;
            /** @description The figure. */
            figure: components["schemas"]["Figure"];
            /**
             * Format: double
             * @description Mean over these nodes during the trial.
             */
            mean: number;
            /** @description The number of nodes with enough clips before and during the trial. */
            nodes: number;
        };
        /** @description The result of one value. */
        ArmResult: {
            /** @description The number of them that reported the value. */
            applied: number;
            /** @description Its figures. */
            figures: components["schemas"]["ArmFigure"][];
            /** @description The number of nodes of the group. */
            nodes: number;
            /** @description The number of those that made clips before the trial and none during it. */
            silent: number;
            /** @description The value. */
            value: components["schemas"]["Threshold"];
        };
        /** @description A page of invalid reports, the latest first. */
        AsidePage: {
            /**
             * Format: int64
             * @description The `cursor` of the next page; absent on the last page.
             */
            next?: number | null;
            reports: components["schemas"]["StoredSetAside"][];
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
        /** @description The fields that the plans of rollouts and trials share. */
        Basics: {
            /**
             * Format: double
             * @description Time that a reachable node has to report the value, seconds.
             * @default 120
             */
            apply_within_s: number;
            /**
             * Format: double
             * @description The length of the baseline before the change, seconds.
             * @default 604800
             */
            baseline_s: number;
            /**
             * Format: double
             * @description The confidence of verdicts. With 0.95, at most one of twenty rollouts without any effect fails, over all gates, stages
             *     and looks together, and at most one of twenty changes beyond a bound passes its stage. For a trial it is the
             *     probability that all intervals together contain the true values.
             * @default 0.95
             */
            confidence: number;
            /**
             * Format: int64
             * @description Fewest clips of a node before and after; nodes with fewer are left out.
             * @default 5
             */
            fewest_clips: number;
            /**
             * Format: int64
             * @description The seed that draws the order of the nodes, or the groups; by default the hub chooses one.
             * @default null
             */
            seed: number | null;
            /**
             * @description Selects the nodes.
             * @default [
             *       "all"
             *     ]
             */
            select: string[];
            /**
             * @description The reason, for the history.
             * @default
             */
            why: string;
        };
        /**
         * @description The state of a camera's frames.
         * @enum {string}
         */
        CameraState: "live" | "stale" | "never_seen";
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
        /** @description The GeoJSON of a clip. */
        ClipFeature: {
            /** @description West, south, east, north, degrees. */
            bbox: number[];
            geometry: components["schemas"]["Geometry"];
            /**
             * Format: int64
             * @description Its number in the database.
             */
            id: number;
            properties: components["schemas"]["Properties"];
            /** @description `Feature`. */
            type: string;
        };
        /** @description A page of clips, the last received first. */
        ClipPage: {
            clips: components["schemas"]["StoredClip"][];
            /**
             * Format: int64
             * @description The `cursor` of the next page; absent on the last page.
             */
            next?: number | null;
        };
        /**
         * @description A command to a rollout.
         * @enum {string}
         */
        Command: "pause" | "resume" | "next" | "return" | "stop";
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
        /** @description What was deleted. */
        Deleted: {
            /** @description Clips whose positions are gone. */
            clips: number;
        };
        /** @description The desired setting of a node: a threshold or a target. A node has only one, so each kind replaces the other. */
        DesiredSetting: {
            /** @description A threshold: `{"threshold": {"name": "u", "value": 3e-4}}`. It switches a target off. */
            threshold: components["schemas"]["Threshold"];
        } | {
            target: components["schemas"]["Target"] | null;
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
        /** @description A node that applied its desired setting, and has another one now. */
        Drift: {
            /** @description The desired setting: a threshold or a target. */
            desired: components["schemas"]["DesiredSetting"];
            in_force?: components["schemas"]["DesiredSetting"] | null;
            /** @description The node. */
            node: string;
            /**
             * Format: int32
             * @description How often it was set back.
             */
            set_back: number;
            /** @description When the hub noticed, milliseconds since the Unix epoch. */
            since_ms: components["schemas"]["i64"];
            /** @description The node's reason why it no longer holds its target. */
            why?: string | null;
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
        /** @description Sums by group and quality. */
        Energy: {
            audit?: components["schemas"]["AuditFigures"] | null;
            /** @description One entry for each group and quality. */
            groups: components["schemas"]["EnergyGroup"][];
            /**
             * @description The spans that were summed: hours if the requested times are whole hours, or so old that sums over five minutes are no
             *     longer kept; else five minutes.
             */
            resolution: components["schemas"]["Resolution"];
            /**
             * Format: int64
             * @description The beginning of the first span, milliseconds since the Unix epoch.
             */
            since_ms: number;
            /**
             * Format: int64
             * @description The end of the last span.
             */
            until_ms: number;
        };
        /**
         * @description The grouping of sums.
         * @enum {string}
         */
        EnergyBy: "all" | "node" | "camera" | "day" | "policy" | "threshold" | "clip";
        /** @description Sums of one group and one quality. */
        EnergyGroup: {
            audit?: components["schemas"]["AuditFigures"] | null;
            /**
             * Format: double
             * @description Estimated energy of the audit, joules: a part of `joules`.
             */
            audit_joules: number;
            /**
             * Format: int64
             * @description Avoided calls of the detector: frames answered without it, except degraded ones.
             */
            avoided_calls: number;
            /**
             * Format: int64
             * @description Clips.
             */
            clips: number;
            /**
             * Format: int64
             * @description Calls of the detector.
             */
            detector_calls: number;
            /**
             * Format: double
             * @description Kilometres that were driven in the clips of which both way and energy are known in full; absent if there are none. As
             *     seconds of clips, they count for each camera of a node.
             */
            distance_km?: number | null;
            /**
             * Format: double
             * @description Seconds of clips.
             */
            duration_s: number;
            /**
             * Format: int64
             * @description Frames.
             */
            frames: number;
            /**
             * @description Node, camera (`node/camera`), day (seconds since the Unix epoch), policy, policy and value (`albireo u=0.0003`), or clip (`node/camera/clip`);
             *     empty for the sum over all.
             */
            group: string;
            /**
             * Format: double
             * @description Energy, joules: exact sums of what the nodes report, in whole microjoules.
             */
            joules: number;
            /**
             * Format: double
             * @description Energy of the whole node in those clips per kilometre, joules, of this quality.
             */
            joules_per_km?: number | null;
            /** @description Sums of different qualities are never added. */
            quality: components["schemas"]["EnergyQuality"];
            /**
             * Format: double
             * @description Energy that the avoided calls would have cost, joules: always an estimate, summed over the nodes' reports.
             */
            saved_joules_estimated: number;
            /**
             * Format: double
             * @description Share of frames with state E or P that are not degraded.
             */
            skip_rate: number;
            /**
             * Format: int64
             * @description Avoided calls that the estimate leaves out, because their node did not know the cost of a call.
             */
            unpriced_calls: number;
        };
        /**
         * @description The quality of an energy figure, from the most to the least reliable.
         * @enum {string}
         */
        EnergyQuality: "measured" | "partial" | "estimated" | "unavailable";
        /** @description An entry of the record. */
        Entry: {
            /** @description When, milliseconds since the Unix epoch. */
            at_ms: components["schemas"]["i64"];
            /** @description Each gate with its numbers. */
            gates?: components["schemas"]["GateResult"][];
            /** @description The stage, from 1. */
            stage: number;
            /** @description Details, as text. */
            text?: string;
            verdict?: components["schemas"]["Verdict"] | null;
            /** @description Its kind. */
            what: components["schemas"]["What"];
            /** @description Who commanded it; absent if the hub did it by itself. */
            who?: string | null;
        };
        /**
         * @description A figure of clips. Energy that was metered over only a part of the clip is in no figure.
         * @enum {string}
         */
        Figure: "skip_rate" | "joules_measured" | "joules_estimated" | "edp_measured" | "edp_estimated" | "latency_p99" | "degraded" | "recall" | "precision";
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
        /** @description A gate's verdict on one figure, with its numbers. */
        GateResult: {
            /**
             * Format: double
             * @description Mean over the changed nodes after; absent if there are none.
             */
            after?: number | null;
            /**
             * Format: double
             * @description Mean over the changed nodes before; absent if there are none.
             */
            before?: number | null;
            change?: components["schemas"]["Interval"] | null;
            /** @description The number of unchanged nodes with enough clips over the same hours. */
            compared: number;
            figure?: components["schemas"]["Figure"] | null;
            /** @description The gate, as written. */
            gate: string;
            /** @description The number of changed nodes with enough clips before and after. */
            nodes: number;
            /** @description The verdict. */
            verdict: components["schemas"]["Verdict"];
        };
        /** @description A way, or the place of a camera that did not move. Longitude and latitude, degrees. */
        Geometry: {
            coordinates: number[];
            /** @enum {string} */
            type: "Point";
        } | {
            coordinates: number[][];
            /** @enum {string} */
            type: "LineString";
        };
        /** @description A desired setting that was given to a node: its revision, and what became of it. */
        Given: {
            /** @description When the hub learned the outcome, milliseconds since the Unix epoch. */
            at_ms: components["schemas"]["i64"];
            /** @description The reason for the outcome; empty without one. */
            detail: string;
            /** @description When it was given; for a node that was out of reach, when that returned. */
            given_ms: components["schemas"]["i64"];
            /** @description The outcome. */
            outcome: components["schemas"]["Outcome"];
            /**
             * Format: int64
             * @description Its revision.
             */
            revision: number;
        };
        /** @description The process answers. */
        Health: {
            /** @description Always `ok`. */
            status: string;
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
        /** @description [`HubReadiness`] as a problem document. */
        HubNotReady: components["schemas"]["Problem"] & components["schemas"]["HubReadiness"];
        /** @description The readiness of the hub to accept and commit reports. */
        HubReadiness: {
            /** @description True if every part works. */
            ready: boolean;
            /**
             * @description The reason of each part that does not work, or works only in part: `database`, `zenoh`,
             *     `certificates`, `fleet`, `tuning`, `tasks`.
             */
            reasons: {
                [key: string]: string;
            };
        };
        /** @description Service, version and list of routes. */
        Index: {
            /** @description The path of the full description. */
            openapi: string;
            /** @description All routes. */
            routes: components["schemas"]["Route"][];
            /** @description Always `hub`. */
            service: string;
            /** @description The program's version. */
            version: string;
        };
        /** @description The confidence interval of a change: a share of the value before, or in the figure's unit. */
        Interval: {
            /**
             * Format: double
             * @description The estimate.
             */
            estimate: number;
            /**
             * Format: double
             * @description Lower end.
             */
            lower: number;
            /**
             * Format: double
             * @description Upper end.
             */
            upper: number;
        };
        /** @description A rollout or a trial, with its plan. */
        Kind: {
            /** @enum {string} */
            kind: "rollout";
            /** @description The plan. */
            plan: components["schemas"]["RolloutPlan"];
            /** @description The new value. */
            to: components["schemas"]["Threshold"];
        } | {
            /** @enum {string} */
            kind: "trial";
            /** @description The plan. */
            plan: components["schemas"]["TrialPlan"];
        };
        /** @description A node that was selected and takes no part, and why. */
        LeftOut: {
            /** @description The node. */
            node: string;
            /** @description The reason. */
            why: string;
        };
        /** @description One node of a rollout or trial. */
        Member: components["schemas"]["Given"] & {
            /** @description Its value at the beginning. */
            before: components["schemas"]["Threshold"];
            /** @description Its stage or group, from 0. */
            group: number;
            /** @description Its name. */
            node: string;
            /** @description True if it was in reach when the run was stored. */
            reachable: boolean;
            value?: components["schemas"]["Threshold"] | null;
            /** @description True if it was in reach when the present stage began. */
            was_reachable: boolean;
        };
        /**
         * @description Gives selected nodes a desired setting. The setting is a further field: the threshold under the policy's name for it,
         *     such as `"u": 5e-4`, or `target`.
         */
        NewRevision: {
            /** @description True to report only which nodes would change. */
            dry_run?: boolean;
            /** @description Selects the nodes: names, globs, labels, `all`. */
            select: string[];
            /**
             * Format: double
             * @description Time to wait for the nodes, seconds: 5 by default, at most 8 for a plain answer.
             */
            wait_s?: number | null;
            /** @description The reason, for the history. */
            why?: string;
        };
        /** @description A node with the counts of its reports. */
        NodeDetail: components["schemas"]["NodeView"] & {
            reports?: components["schemas"]["ReportCounts"] | null;
        };
        /** @description A page of nodes. */
        NodeList: {
            /** @description The number of nodes in the whole fleet, by state. */
            counts: {
                [key: string]: number;
            };
            /** @description The rows. */
            nodes: components["schemas"]["NodeView"][];
            /** @description The number of rows before this page. */
            offset: number;
            /** @description The number of selected rows, on all pages. */
            total: number;
            /**
             * Format: int64
             * @description Reports that wait in the outboxes of the whole fleet.
             */
            waiting: number;
        };
        /** @description The desired setting of a node, and what became of it. */
        NodeSetting: components["schemas"]["Given"] & {
            from?: components["schemas"]["DesiredSetting"] | null;
            /** @description The node. */
            node: string;
            /** @description The setting: a threshold, or a target (null switches it off). */
            to: components["schemas"]["DesiredSetting"];
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
        /** @description A node, as the HTTP interface shows it. */
        NodeView: {
            /**
             * Format: int64
             * @description When the last status was received, milliseconds since the Unix epoch.
             */
            heard_ms?: number | null;
            /** @description Its name. */
            node: string;
            /**
             * Format: int64
             * @description The revision in force at the node.
             */
            revision: number;
            /**
             * Format: int64
             * @description When that state began, milliseconds since the Unix epoch.
             */
            since_ms: number;
            /** @description Its state. */
            state: components["schemas"]["PresenceState"];
            status?: components["schemas"]["NodeStatus"] | null;
            /** @description The energy and skip rate of its clips of today (UTC). */
            today: components["schemas"]["TodaysEnergy"];
            /**
             * Format: int64
             * @description Reports that wait in its outbox.
             */
            waiting: number;
            /** @description The reason for the state; empty when online. */
            why: string;
        };
        /**
         * @description The reaction of a rollout to a failed gate.
         * @enum {string}
         */
        OnFailure: "return" | "hold";
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
        /**
         * @description The outcome of a desired setting at a node.
         * @enum {string}
         */
        Outcome: "untouched" | "pending" | "waiting" | "applied" | "refused" | "timed_out" | "missed" | "superseded" | "unchanged" | "would_change";
        /**
         * @description The phase of a rollout or a trial.
         * @enum {string}
         */
        Phase: "applying" | "soaking" | "running" | "held" | "finishing" | "returning" | "done" | "returned" | "stopped";
        /** @description A clip with its figures, where positions are known. */
        PositionedClip: {
            /**
             * Format: int64
             * @description When it began, milliseconds since the Unix epoch.
             */
            at_ms: number;
            /** @description Camera. */
            camera: string;
            /** @description Clip id. */
            clip: string;
            /**
             * Format: double
             * @description Distance driven, metres.
             */
            distance_m: number;
            /**
             * Format: double
             * @description Its length, seconds.
             */
            duration_s: number;
            /**
             * Format: int64
             * @description Frames.
             */
            frames: number;
            /**
             * Format: double
             * @description Energy of the camera's share, joules.
             */
            joules?: number | null;
            /**
             * Format: double
             * @description Energy of the whole node per kilometre, joules; null if it is not known in full or the camera did not move.
             */
            joules_per_km?: number | null;
            /** @description Node. */
            node: string;
            /**
             * Format: int64
             * @description Number of this part of the clip, from 0.
             */
            part: number;
            /** @description Quality of the energy. */
            quality: components["schemas"]["EnergyQuality"];
            /**
             * Format: double
             * @description Share of frames that skipped the detector.
             */
            skip_rate: number;
        };
        /** @description The GeoJSON of clips, the last first. */
        Positions: {
            /** @description One for each clip. */
            features: components["schemas"]["ClipFeature"][];
            /** @description True if there are more clips than `limit`: ask again with `until_ms` of the last one's `at_ms`. */
            truncated: boolean;
            /** @description `FeatureCollection`. */
            type: string;
        };
        /**
         * @description The state of a node.
         * @enum {string}
         */
        PresenceState: "online" | "degraded" | "silent" | "offline";
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
        /** @description The figures of a clip. */
        Properties: components["schemas"]["PositionedClip"] & {
            /** @description When it began, and when it ended, as dates of RFC 3339. */
            began: string;
            ended: string;
            /**
             * Format: double
             * @description The highest speed, metres per second; null if no position had one.
             */
            fastest_m_s?: number | null;
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
        /** @description Counts of a node's reports. */
        ReportCounts: {
            /**
             * Format: int64
             * @description When the first batch was received, milliseconds since the Unix epoch.
             */
            first_ms: number;
            /**
             * Format: int64
             * @description When the last batch was received.
             */
            last_ms: number;
            /**
             * Format: int64
             * @description Reports that were never received, by their running counts.
             */
            missing: number;
            /**
             * Format: int64
             * @description Reports refused, because they were too old.
             */
            refused: number;
            /**
             * Format: int64
             * @description How often the running count restarted: the node's state was new, older or a copy.
             */
            resets: number;
            /**
             * Format: int64
             * @description Invalid reports.
             */
            set_aside: number;
            /**
             * Format: int64
             * @description Reports stored.
             */
            stored: number;
        };
        /**
         * @description The length of the spans that were summed.
         * @enum {string}
         */
        Resolution: "five_minutes" | "hour";
        /** @description A desired setting that was given to some nodes at once. */
        Revision: {
            /** @description When, milliseconds since the Unix epoch. */
            at_ms: components["schemas"]["i64"];
            /** @description The number of nodes by outcome. */
            counts: {
                [key: string]: number;
            };
            /** @description The outcome at each node; absent in a list, and at the end of a stream, which had them before. */
            nodes: components["schemas"]["NodeSetting"][];
            /** @description Its origin: `hand`, `rollout 3`, `trial 4`, `drift`. */
            origin: string;
            /**
             * Format: int64
             * @description Its number, which nodes report with their setting: `/api/v1/revisions/{revision}` shows its progress. Absent in a dry
             *     run, and if no node would change.
             */
            revision?: number | null;
            /** @description The selector; empty for a rollout or trial. */
            select: string;
            /** @description The setting: a threshold, or a target (null switches it off). */
            to: components["schemas"]["DesiredSetting"];
            /** @description The name of the caller's token. */
            who: string;
            /** @description The reason. */
            why: string;
        };
        /** @description Revisions, the newest first. */
        Revisions: {
            /**
             * Format: int64
             * @description The `before` of the next page; absent on the last page.
             */
            next?: number | null;
            /** @description One entry for each revision. */
            revisions: components["schemas"]["Revision"][];
        };
        /** @description A change in stages. */
        RolloutPlan: components["schemas"]["Basics"] & {
            /**
             * Format: double
             * @description Share of a stage's reachable nodes that must report the value; with fewer the stage fails.
             * @default 0.9
             */
            fewest_applied: number;
            /**
             * @description The gates, which bound what the change may cost.
             * @default [
             *       "skip_rate>=-0.05",
             *       "joules<=+5%?",
             *       "latency_p99<=+10%",
             *       "degraded<=+0.01"
             *     ]
             */
            gates: string[];
            /**
             * Format: double
             * @description Time that the rollout is held for a person to decide before the old value returns, seconds.
             * @default 86400
             */
            held_for_s: number;
            /**
             * Format: double
             * @description Time that a node may stay out of reach, seconds; then its value is withdrawn, and the record names it.
             * @default 604800
             */
            offline_deadline_s: number;
            /**
             * @description The reaction to a failed gate.
             * @default return
             */
            on_failure: components["schemas"]["OnFailure"];
            /**
             * Format: double
             * @description Further time that a stage soaks if its gates are undecided at the end of the soak, seconds.
             * @default 172800
             */
            patience_s: number;
            /**
             * Format: double
             * @description Time that a stage soaks before its gates are judged, seconds.
             * @default 86400
             */
            soak_s: number;
            /**
             * @description The number of nodes that have the new value in each stage, earlier stages included: `1`, `10%`, `all`. Nodes that the
             *     last stage leaves out keep the old value, and the last stage is compared with them.
             * @default [
             *       "1",
             *       "10%",
             *       "50%",
             *       "90%"
             *     ]
             */
            stages: string[];
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
        /** @description A rollout or a trial: its plan, nodes, phase and record. */
        Run: components["schemas"]["Kind"] & {
            /** @description When, milliseconds since the Unix epoch. */
            begun_ms: components["schemas"]["i64"];
            /** @description Who ended a trial before its time. */
            ended_by?: string | null;
            ended_ms?: components["schemas"]["i64"] | null;
            /**
             * Format: int64
             * @description Its number, among those of its kind.
             */
            id: number;
            /** @description Selected nodes that take no part; only in the answer to the request that begins it. */
            left_out?: components["schemas"]["LeftOut"][];
            /**
             * Format: int32
             * @description How often this stage's gates were judged.
             */
            looks?: number;
            /** @description Its nodes, in the order of their stages; absent in a list. */
            nodes?: components["schemas"]["Member"][];
            paused_ms?: components["schemas"]["i64"] | null;
            /** @description Its phase. */
            phase: components["schemas"]["Phase"];
            /** @description Why it is held, or why the old values return. */
            reason?: string;
            /** @description Its record, oldest entry first; absent in a list. */
            record?: components["schemas"]["Entry"][];
            result?: components["schemas"]["TrialResult"] | null;
            /**
             * Format: int64
             * @description The seed that drew the order of the nodes, or the groups.
             */
            seed: number;
            /** @description When the phase began. */
            since_ms: components["schemas"]["i64"];
            /**
             * Format: int32
             * @description How often this stage has soaked: once, and once more after each resumed hold.
             */
            soaks: number;
            /** @description The stage it is in, from 1. */
            stage: number;
            /** @description Its stages or groups. */
            stages: components["schemas"]["StageView"][];
            /** @description Who began it. */
            who: string;
        };
        /** @description Rollouts or trials, the newest first. */
        Runs: {
            /**
             * Format: int64
             * @description The `before` of the next page; absent on the last page.
             */
            next?: number | null;
            /** @description One entry per run, without its record and nodes. */
            runs: components["schemas"]["Run"][];
        };
        /**
         * @description The origin of a threshold or a target.
         * @enum {string}
         */
        SettingSource: "configuration" | "local" | "hub";
        /**
         * @description The order of the groups.
         * @enum {string}
         */
        Sort: "group" | "joules";
        /** @description A stage of a rollout, or a group of a trial. */
        StageView: {
            /** @description The number of them by outcome. */
            counts: {
                [key: string]: number;
            };
            /** @description The number of nodes that it adds. */
            nodes: number;
        };
        /** @description A clip. */
        StoredClip: {
            /**
             * Format: int64
             * @description Frames with state AI.
             */
            ai: number;
            /**
             * Format: int64
             * @description The time under which it is stored, milliseconds since the Unix epoch: when it began, or when it was received if the
             *     node's clock is wrong.
             */
            at_ms: number;
            audit?: components["schemas"]["AuditFigures"] | null;
            /** @description Camera. */
            camera: string;
            /** @description Clip id. */
            clip: string;
            /**
             * Format: int64
             * @description Running count of the report at its node.
             */
            count?: number | null;
            /**
             * Format: int64
             * @description Frames answered from prediction because the detector was not available.
             */
            degraded: number;
            /**
             * Format: int64
             * @description Calls of the detector.
             */
            detector_calls: number;
            /**
             * Format: double
             * @description Mean time of a call, milliseconds.
             */
            detector_mean_ms: number;
            /**
             * Format: double
             * @description Distance driven, metres, if the node knows its position. `/api/v1/positions.geojson` has the way.
             */
            distance_m?: number | null;
            /**
             * Format: int64
             * @description Frames not processed.
             */
            dropped: number;
            /**
             * Format: double
             * @description Its length, seconds.
             */
            duration_s: number;
            /**
             * Format: int64
             * @description Frames with state E.
             */
            e: number;
            /**
             * Format: double
             * @description Energy-delay product, J·ms/frame.
             */
            edp?: number | null;
            /**
             * Format: int64
             * @description Frames with state E+I.
             */
            ei: number;
            /** @description Why it ended. */
            ended_by: string;
            /**
             * Format: int64
             * @description Frames.
             */
            frames: number;
            /**
             * Format: int64
             * @description Frames with state I.
             */
            i: number;
            /**
             * Format: int64
             * @description Its number in the database: the later it was received, the higher.
             */
            id: number;
            /**
             * Format: double
             * @description Energy, joules.
             */
            joules?: number | null;
            /**
             * Format: double
             * @description Mean latency, milliseconds.
             */
            latency_mean_ms: number;
            /**
             * Format: double
             * @description 99th percentile of the latency, milliseconds.
             */
            latency_p99_ms: number;
            /** @description Detector model. */
            model: string;
            /** @description Node. */
            node: string;
            /**
             * Format: int64
             * @description Frames with state P.
             */
            p: number;
            /**
             * Format: int64
             * @description Number of this part of the clip, from 0.
             */
            part: number;
            /** @description Policy. */
            policy: string;
            /** @description Where the energy comes from. */
            power_source: string;
            /** @description Execution provider. */
            provider: string;
            /** @description `measured`, `partial`, `estimated` or `unavailable`. */
            quality: components["schemas"]["EnergyQuality"];
            /**
             * Format: int64
             * @description When it was received.
             */
            received_ms: number;
            /** @description Identity of the report. */
            report_id: string;
            /** @description Name of its threshold, or of the target that moves it; empty without one. */
            threshold: string;
            /**
             * Format: double
             * @description The value of the threshold at the end of the clip, or of the target.
             */
            value?: number | null;
        };
        /** @description An event. */
        StoredEvent: {
            /**
             * Format: int64
             * @description When, milliseconds since the Unix epoch.
             */
            at_ms: number;
            /** @description Details, by kind. */
            detail: unknown;
            /**
             * Format: int64
             * @description Its number: the later, the higher.
             */
            id: number;
            /** @description Its kind: `node`, `gap`, `reset`, `set_aside`, `clock_off`, `refused`, `drift`, `forgotten`. */
            kind: string;
            /** @description The node it is about. */
            node?: string | null;
        };
        /** @description An invalid report. */
        StoredSetAside: {
            /** @description Its text, at most 16 KiB. */
            body: string;
            /** @description Why it is invalid. */
            cause: string;
            /**
             * Format: int64
             * @description Its number.
             */
            id: number;
            /** @description The node that sent it. */
            node: string;
            /**
             * Format: int64
             * @description When it was received.
             */
            received_ms: number;
            /** @description Identity of the report. */
            report_id?: string | null;
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
        /** @description The energy and skip rate of a node's clips of today. Measured and estimated energy are never added. */
        TodaysEnergy: {
            /**
             * Format: double
             * @description Joules computed from utilisation.
             */
            estimated_joules: number;
            /**
             * Format: double
             * @description Joules read from a meter, even if it covers only part of the time.
             */
            measured_joules: number;
            /**
             * Format: double
             * @description Share of the detector's boxes on audited skipped frames that were shown, 0 to 1; absent without such a box.
             */
            recall?: number | null;
            /**
             * Format: double
             * @description Share of the frames that skipped the detector, 0 to 1; absent without a frame.
             */
            skip_rate?: number | null;
        };
        /** @description A comparison of values on random groups of nodes over the same time. */
        TrialPlan: components["schemas"]["Basics"] & {
            /**
             * Format: double
             * @description Time that the nodes keep the values once they have reported them, seconds.
             * @default 3600
             */
            duration_s: number;
            /**
             * @description The values, two or more of one threshold; each is compared with the first.
             * @default []
             */
            values: components["schemas"]["Threshold"][];
        };
        /** @description The result of a trial. */
        TrialResult: {
            /**
             * Format: double
             * @description Probability that all intervals together contain the true values.
             */
            confidence: number;
            /** @description The beginning of the time in which clips counted. */
            from_ms: components["schemas"]["i64"];
            /** @description The end of that time. */
            until_ms: components["schemas"]["i64"];
            /** @description Each value, in the plan's order. */
            values: components["schemas"]["ArmResult"][];
        };
        /**
         * @description The verdict of a gate or a stage, the best first.
         * @enum {string}
         */
        Verdict: "passed" | "not_measured" | "undecided" | "failed";
        /**
         * @description The kind of an entry.
         * @enum {string}
         */
        What: "begun" | "stage" | "soaking" | "judged" | "held" | "missed" | "returning" | "returned" | "done" | "paused" | "resumed" | "next" | "return" | "stopped";
        /** @description The caller. */
        WhoAsks: {
            /** @description True if the caller may change settings, and not only read. */
            may_tune: boolean;
            /** @description The name of the token; `anonymous` without one. */
            name: string;
            /** @description True if the interface needs a token that the request lacks. */
            token_needed: boolean;
        };
        /** Format: int64 */
        i64: number;
    };
    responses: never;
    parameters: never;
    requestBodies: never;
    headers: never;
    pathItems: never;
}
export type $defs = Record<string, never>;
export type operations = Record<string, never>;
