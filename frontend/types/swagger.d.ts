/** The part of Swagger UI that the documentation uses. */

interface DocumentedRequest {
  method?: string;
  headers: Record<string, string>;
}

interface Window {
  SwaggerUIBundle?(options: {
    url: string;
    dom_id: string;
    docExpansion: "none" | "list" | "full";
    filter: boolean;
    tryItOutEnabled: boolean;
    validatorUrl: string | null;
    requestInterceptor(request: DocumentedRequest): Promise<DocumentedRequest>;
  }): void;
}
